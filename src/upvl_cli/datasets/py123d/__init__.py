"""Logs of the library py123d (docs/datasets/py123d.md), read in place through that library."""
