"""Declared settings and the TOML files that hold their values."""
