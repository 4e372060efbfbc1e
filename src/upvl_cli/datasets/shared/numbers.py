"""Numbers in lines of text."""

from __future__ import annotations

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.types import Array


def numbers(text: str, count: int, where: str) -> Array:
    """Return the numbers of one line.

    Args:
        text: Numbers between blanks.
        count: How many there must be.
        where: File and line, for the message.

    Returns:
        (count,) finite float64.

    Raises:
        BadInput: There are more or fewer, or one is no finite number.
    """
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        shown = f"{text.strip()[:80]!r}, {len(text.split())} fields"
        raise BadInput(f"{where} holds {shown}; expected {count} finite numbers: copy the file again")
    return values
