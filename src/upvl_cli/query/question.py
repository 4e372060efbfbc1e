"""A question to the features: vectors of the words that are asked for, and of what they compete with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes
from upvl_cli.stages import classify, mask
from upvl_cli.types import Bools, Floats, Ints, Model
from upvl_cli.vlm.base import Speller

# A kind ("fire truck") and what it is a kind of ("truck") are always near; from this cosine on, a model does not tell
# one from the other.
AS_ITS_KIND = 0.95


@dataclass(frozen=True)
class Question:
    """Words as vectors.

    Attributes:
        names: The classes that are asked for; they have the numbers from 0 on.
        words: All words, those asked for first.
        kind_of_word: (t,) class of each word; each negative is a kind of its own.
        vectors: (t, d) of length 1.
        blurred: Asked words that the model does not tell from what they are a kind of, and that.
    """

    names: tuple[str, ...]
    words: tuple[str, ...]
    kind_of_word: Ints
    vectors: Floats
    blurred: tuple[tuple[str, str], ...] = ()

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
    blurred: tuple[tuple[str, str], ...] = ()
    if negatives is None:
        negatives, beside, blurred = against(workspace, classes.all_words, vectors, same)
        vectors = np.concatenate([vectors, beside])
    sizes = [*(len(some) for some in classes.words.values()), *(1 for _ in negatives)]
    return Question(
        tuple(classes.words),
        (*classes.all_words, *negatives),
        np.repeat(np.arange(len(sizes)), sizes),
        vectors,
        blurred,
    )


def against(
    workspace: Workspace, asked: Sequence[str], vectors: Floats, same: float
) -> tuple[tuple[str, ...], Floats, tuple[tuple[str, str], ...]]:
    """The words that compete with those asked for: of the background and of common objects.

    Those that say the same as an asked word are left out: a list of `name` that is asked for by its name
    ("vehicle"), kinds of it ("school bus" where "bus" is asked for), and what is very near. What an asked word is a
    kind of competes ("truck" where "garbage truck" is asked for), for the kind is to be told from the rest; unless
    the model has one vector for both: then the one that wins would be chance.

    Args:
        workspace: Its `mask.toml` and `classify.toml` have them.
        asked: The words asked for.
        vectors: (a, d) theirs.
        same: Cosine from which a word says the same.

    Returns:
        The words, (t, d) their vectors, and the pairs of an asked word and what the model takes it for.
    """
    names = workspace.settings(classify.STAGE)
    lists = {spec.name: getattr(names, spec.name) for spec in fields(names)}
    apart = {word for name, some in lists.items() if name in asked for word in some}
    common = (
        *workspace.settings(mask.STAGE).background,
        *(word for some in lists.values() for word in some),
    )
    words = [word for word in dict.fromkeys(common) if word not in apart]
    found = _vectors(workspace.model, words)
    cosines = found @ vectors.T  # (t, a)
    kept = [
        place
        for place, word in enumerate(words)
        if not any(_says_the_same(word, *beside, same) for beside in zip(asked, cosines[place], strict=True))
    ]
    blurred = tuple(
        (one, words[place])
        for place, column in np.argwhere(cosines >= max(same, AS_ITS_KIND)).tolist()
        if _is_kind_of(one := asked[column], words[place])
    )
    return tuple(words[place] for place in kept), found[kept], blurred


def _says_the_same(word: str, asked: str, cosine: float, same: float) -> bool:
    limit = max(same, AS_ITS_KIND) if _is_kind_of(asked, word) else same
    return set(word.lower().split()) >= set(asked.lower().split()) or cosine >= limit


def _is_kind_of(word: str, other: str) -> bool:
    return set(word.lower().split()) > set(other.lower().split())


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
