"""Words that are likely typing errors: a table of tokens has some vector for any string."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Set

MIN_RATIO = 0.65  # of difflib's ratio: "vna" is 0.67 from "van"
PLURALS = (("ies", "y"), ("es", ""), ("s", ""))


def unknown_words(
    words: Iterable[str], known: Callable[[str], bool], common: Set[str]
) -> list[tuple[str, str]]:
    """Return the words that are not known, each with its likely spelling, or "".

    Plurals of known words are known, and so is what is written together of two common words: "firetruck".

    Args:
        words: Single words in lower case.
        known: Tells whether a string is a word.
        common: The words that are proposed.
    """

    def is_word(word: str) -> bool:
        stems = [
            word,
            *(word.removesuffix(end) + singular for end, singular in PLURALS if word.endswith(end)),
        ]
        is_compound = any(word[:at] in common and word[at:] in common for at in range(3, len(word) - 2))
        return is_compound or any(stem in common or known(stem) for stem in stems)

    return [(word, _likely_spelling(word, common)) for word in dict.fromkeys(words) if not is_word(word)]


def _likely_spelling(word: str, common: Set[str]) -> str:
    close = difflib.get_close_matches(word, sorted(common), n=5, cutoff=MIN_RATIO)
    # Letters that changed places are the commonest slip: "trcuk" is "truck" and not "trunk".
    swapped = [candidate for candidate in close if sorted(candidate) == sorted(word)]
    return next(iter([*swapped, *close]), "")
