"""Which way the axes of a LiDAR point."""

from __future__ import annotations

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.types import Array

_WAYS = {"f": (1, 0, 0), "b": (-1, 0, 0), "l": (0, 1, 0), "r": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)}


def ego_from_axes(letters: str) -> Array:
    """Return the (4, 4) turn into ego axes: x forward, y left, z up.

    Args:
        letters: Where x, y and z of the LiDAR point: f, b, l, r, u or d each, for example "flu" or "rfu".

    Raises:
        BadSetting: They are no right-handed axes.
    """
    turn = np.eye(4)
    if len(letters) == 3 and set(letters) <= set(_WAYS):
        turn[:3, :3] = np.array([_WAYS[letter] for letter in letters]).T
        if np.linalg.det(turn) > 0.5:
            return turn
    raise BadSetting(
        f"--axes is {letters[:20]!r}, expected three letters of right-handed axes: where x, y and z point, each "
        "f(orward), b(ack), l(eft), r(ight), u(p) or d(own), for example flu or rfu"
    )
