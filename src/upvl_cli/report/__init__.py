"""One self-contained HTML page about a run: what was found, what it cost, and what changed against another run."""
