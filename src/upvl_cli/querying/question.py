"""A question to the features: vectors of the words that are asked for, and of what they compete with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.querying.classes import Classes
from upvl_cli.stages import BY_NAME
from upvl_cli.types import Bools, Floats, Ints
from upvl_cli.vlm.base import Model, Speller
from upvl_cli.workspace import Workspace


@dataclass(frozen=True)
class Question:
    """Words as vectors.

    Attributes:
        names: The classes that are asked for; they have the numbers from 0 on.
        words: All words, those asked for first.
        kind_of_word: (t,) class of each word; each negative is a kind of its own.
        vectors: (t, d) of length 1.
    """

    names: tuple[str, ...]
    words: tuple[str, ...]
    kind_of_word: Ints
    vectors: Floats

    @property
    def asked(self) -> Bools:
        """(t,) which words are asked for."""
        return self.kind_of_word < len(self.names)


def question(workspace: Workspace, classes: Classes, *, same: float, anyway: bool) -> Question:
    """Look up the words.

    Args:
        workspace: Whose model, and whose words to compete with.
        classes: What is asked for.
        same: A word of the workspace's own this near to one that is asked for does not compete.
        anyway: Take what is likely misspelt as it is.

    Raises:
        BadSetting: A word is likely misspelt, or has no vector.
    """
    model = workspace.model
    given = [*classes.all_words, *(classes.negatives or ())]
    if not anyway:
        _check_spelling(model, given)
    vectors = _vectors(model, given)
    negatives = classes.negatives
    if negatives is None:
        negatives, beside = against(workspace, classes.all_words, vectors, same)
        vectors = np.concatenate([vectors, beside])
    sizes = [*(len(some) for some in classes.words.values()), *(1 for _ in negatives)]
    return Question(
        tuple(classes.words),
        (*classes.all_words, *negatives),
        np.repeat(np.arange(len(sizes)), sizes),
        vectors,
    )


def against(
    workspace: Workspace, asked: Sequence[str], vectors: Floats, same: float
) -> tuple[tuple[str, ...], Floats]:
    """The words that compete with those asked for: of the background and of common objects.

    Those that say the same as an asked word are left out: a list of `name` that is asked for by its name
    ("vehicle"), kinds of it ("school bus" where "bus" is asked for), and what is very near. What an asked word is a
    kind of stays ("truck" where "fire truck" is asked for), for the kind is to be told from the rest.

    Args:
        workspace: Its `mask.toml` and `name.toml` have them.
        asked: The words asked for.
        vectors: (a, d) theirs.
        same: Cosine from which a word says the same.

    Returns:
        The words, and (t, d) their vectors.
    """
    names = workspace.settings(BY_NAME["name"])
    lists = {spec.name: getattr(names, spec.name) for spec in fields(names)}
    apart = {word for name, some in lists.items() if name in asked for word in some}
    common = (
        *workspace.settings(BY_NAME["mask"]).background,
        *(word for some in lists.values() for word in some),
    )
    words = [word for word in dict.fromkeys(common) if word not in apart]
    found = _vectors(workspace.model, words)
    near = found @ vectors.T >= same  # (t, a)
    kept = [
        place
        for place, word in enumerate(words)
        if not any(
            _says_the_same(word, one, bool(alike)) for one, alike in zip(asked, near[place], strict=True)
        )
    ]
    return tuple(words[place] for place in kept), found[kept]


def _says_the_same(word: str, asked: str, near: bool) -> bool:
    parts, wanted = set(word.lower().split()), set(asked.lower().split())
    return parts >= wanted or (near and not parts < wanted)


def _check_spelling(model: Model, words: Sequence[str]) -> None:
    slips = model.unknown_words(words) if isinstance(model, Speller) else []
    if slips:
        told = [
            f'no such word: "{word}"' + (f'; did you mean "{meant}"?' if meant else "")
            for word, meant in slips
        ]
        raise BadSetting(f"{' '.join(told)} (--anyway asks regardless)")


def _vectors(model: Model, words: Sequence[str]) -> Floats:
    vectors = model.embed_text(words)
    empty = [word for word, vector in zip(words, vectors, strict=True) if not vector.any()]
    if empty:
        raise BadSetting(f"{model.name} has no vector for {', '.join(map(repr, empty))}; ask by another word")
    return vectors
