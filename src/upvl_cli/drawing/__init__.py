"""Pictures of labels: arrays in, Pillow images out."""
