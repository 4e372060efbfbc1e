"""Drives of public datasets and of users, each read in place."""
