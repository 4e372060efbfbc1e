"""Words that are likely typing errors: a table of tokens has some vector for any string."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Set

NEAR = 0.65  # of difflib's ratio: "vna" is 0.67 from "van"
PLURALS = (("ies", "y"), ("es", ""), ("s", ""))


def unknown(words: Iterable[str], known: Callable[[str], bool], common: Set[str]) -> list[tuple[str, str]]:
    """The words that are not known, each with the spelling that was perhaps meant, or "".

    Plurals of known words are known, and so is what is written together of two common words: "firetruck".

    Args:
        words: Single words in lower case.
        known: Whether a word is one.
        common: The words that are proposed.
    """

    def right(word: str) -> bool:
        stems = [word, *(word.removesuffix(end) + put for end, put in PLURALS if word.endswith(end))]
        joined = any(word[:at] in common and word[at:] in common for at in range(3, len(word) - 2))
        return joined or any(stem in common or known(stem) for stem in stems)

    return [(word, _meant(word, common)) for word in dict.fromkeys(words) if not right(word)]


def _meant(word: str, common: Set[str]) -> str:
    close = difflib.get_close_matches(word, sorted(common), n=5, cutoff=NEAR)
    # Letters that changed places are the commonest slip: "trcuk" is "truck" and not "trunk".
    swapped = [one for one in close if sorted(one) == sorted(word)]
    return next(iter([*swapped, *close]), "")
