"""Recordings of users' own sensors: what `upvl import` reads. Each source is one module."""
