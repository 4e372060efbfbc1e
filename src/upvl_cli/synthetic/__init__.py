"""A made-up city, computed when it is asked for: the built-in drives, with exact truth."""
