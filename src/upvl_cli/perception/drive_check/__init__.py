"""Checks of what a drive claims: each takes a sample of it and yields findings, without any label."""
