"""How much a track looks like a road user, without any word: a small prior learned from the made-up city."""
