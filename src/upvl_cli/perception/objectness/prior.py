"""The prior that ships with the package: gradient-boosted trees fitted to the truth of the made-up city."""

from __future__ import annotations

from functools import cache

from upvl_cli.perception.objectness.trees import Forest
from upvl_cli.runtime.package_files import package_bytes

FILE = "prior.safetensors"


@cache
def shipped_prior() -> Forest:
    """Return the prior: `training/objectness.py` fits it anew."""
    return Forest.from_bytes(package_bytes(__package__, FILE))
