"""The algorithms of the method: arrays and numbers in, arrays out; no files, no settings."""
