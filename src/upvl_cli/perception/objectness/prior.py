"""The prior that ships with the package: gradient-boosted trees fitted to the truth of the made-up city."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from upvl_cli.perception.objectness.trees import Forest

FILE = "prior.safetensors"


@cache
def shipped_prior() -> Forest:
    """Return the prior: `training/objectness.py` fits it anew."""
    return Forest.from_bytes((files(__package__) / FILE).read_bytes())
