"""Vision-language models: pictures and words in one space."""
