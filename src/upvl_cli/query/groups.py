"""Groups of drives: each has files of its own, so that another drive changes the files of one group alone.

The groups are the leaves of a binary tree over the bits of a digest of the drives' names: a leaf with more than
`GROUP_DRIVES` drives is split by the next bit. So the names alone decide, whatever the order in which drives came, and
a new drive changes one leaf, or splits it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

GROUP_DRIVES = 64  # of 10 000 boxes each: some hundred thousand boxes a group on average
_BITS = 64


def groups_of(names: Iterable[str], most: int = GROUP_DRIVES) -> dict[str, tuple[str, ...]]:
    """Return the drives of each group, in the order of their names, by the name of the group.

    Args:
        names: The drives.
        most: Largest number of drives of a group.
    """
    bits = {name: _bits_of(name) for name in sorted(set(names))}
    leaves: dict[str, tuple[str, ...]] = {}
    waiting: list[tuple[str, Sequence[str]]] = [("", list(bits))] if bits else []
    while waiting:
        prefix, drives = waiting.pop()
        if len(drives) <= most or len(prefix) == _BITS:
            leaves[prefix or "all"] = tuple(drives)
            continue
        for bit in "10":
            part = [name for name in drives if bits[name][len(prefix)] == bit]
            if part:
                waiting.append((prefix + bit, part))
    return leaves


def _bits_of(name: str) -> str:
    digest = hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest()
    return f"{int.from_bytes(digest[: _BITS // 8], 'big'):0{_BITS}b}"
