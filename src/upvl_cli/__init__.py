"""Unsupervised 3D perception with vision-language distillation (UP-VL, ICCV 2023)."""
