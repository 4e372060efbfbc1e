"""The vocabulary of a query: vectors of the queried words and of the negatives that compete with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes
from upvl_cli.query.config import QueryConfig
from upvl_cli.stages import classify, mask
from upvl_cli.types import Bools, Floats, Ints, Model
from upvl_cli.vlm.base import Speller


@dataclass(frozen=True)
class Vocabulary:
    """Words as text embeddings.

    Attributes:
        class_names: The queried classes; class number c of `class_of_word` is the c-th of them.
        words: All t words, the queried ones first.
        class_of_word: (t,) class of each word, ascending; each negative is a class of its own.
        vectors: (t, d) text embeddings of length 1.
        ambiguous: Pairs of a queried word and a more general one that the model cannot distinguish.
    """

    class_names: tuple[str, ...]
    words: tuple[str, ...]
    class_of_word: Ints
    vectors: Floats
    ambiguous: tuple[tuple[str, str], ...] = ()

    @property
    def is_queried(self) -> Bools:
        """(t,) whether each word is queried; the others are negatives."""
        return self.class_of_word < len(self.class_names)


@dataclass(frozen=True)
class Negatives:
    """The negatives that a query has by default.

    Attributes:
        words: The t words.
        vectors: (t, d) text embeddings.
        ambiguous: As in `Vocabulary`.
    """

    words: tuple[str, ...]
    vectors: Floats
    ambiguous: tuple[tuple[str, str], ...]


def build_vocabulary(
    workspace: Workspace, classes: Classes, config: QueryConfig, *, check_spelling: bool
) -> Vocabulary:
    """Embed the words of a query and its negatives.

    Args:
        workspace: Holds the vision-language model, and the settings that the default negatives come from.
        classes: The queried classes.
        config: The cosines from which a default negative does not compete.
        check_spelling: Whether a word that is likely misspelt is refused.

    Raises:
        BadSetting: A word is likely misspelt, or has no vector.
    """
    model = workspace.model
    given = [*classes.all_words, *(classes.negatives or ())]
    if check_spelling:
        _check_spelling(model, given)
    vectors = _vectors(model, given)
    negatives = classes.negatives
    ambiguous: tuple[tuple[str, str], ...] = ()
    if negatives is None:
        default = default_negatives(workspace, classes.all_words, vectors, config)
        negatives, ambiguous = default.words, default.ambiguous
        vectors = np.concatenate([vectors, default.vectors])
    words_per_class = [*(len(words) for words in classes.words.values()), *(1 for _ in negatives)]
    return Vocabulary(
        tuple(classes.words),
        (*classes.all_words, *negatives),
        np.repeat(np.arange(len(words_per_class)), words_per_class),
        vectors,
        ambiguous,
    )


def default_negatives(
    workspace: Workspace, queried: Sequence[str], vectors: Floats, config: QueryConfig
) -> Negatives:
    """Return the words of the background and of common objects that compete with the queried words.

    Left out are the words of a list of `classify.toml` that is queried by its name ("vehicle"), hyponyms of a queried
    word ("school bus" where "bus" is queried), and synonyms: words of a cosine of at least `synonym_cosine`. A
    hypernym of a queried word competes ("truck" where "garbage truck" is queried), because the special is to be
    distinguished from the general; unless the model has nearly one vector for both (`hypernym_cosine`): then chance
    would decide which of them wins.

    Args:
        workspace: Its `mask.toml` and `classify.toml` list the words.
        queried: The a queried words.
        vectors: (a, d) their text embeddings.
        config: The two cosines.
    """
    lists = workspace.settings(classify.STAGE).lists
    of_queried_list = {word for name in queried if name in lists for word in lists[name]}
    common = (
        *workspace.settings(mask.STAGE).background,
        *(word for words in lists.values() for word in words),
    )
    words = [word for word in dict.fromkeys(common) if word not in of_queried_list]
    embedded = _vectors(workspace.model, words)
    cosines = embedded @ vectors.T  # (t, a)
    competes = [
        row
        for row, word in enumerate(words)
        if not any(_is_synonym(word, *pair, config) for pair in zip(queried, cosines[row], strict=True))
    ]
    ambiguous = tuple(
        (queried[column], words[row])
        for row, column in np.argwhere(cosines >= _hypernym_cosine(config)).tolist()
        if is_hyponym(queried[column], words[row])
    )
    return Negatives(tuple(words[row] for row in competes), embedded[competes], ambiguous)


def _is_synonym(word: str, queried: str, cosine: float, config: QueryConfig) -> bool:
    limit = _hypernym_cosine(config) if is_hyponym(queried, word) else config.synonym_cosine
    return set(word.lower().split()) >= set(queried.lower().split()) or cosine >= limit


def _hypernym_cosine(config: QueryConfig) -> float:
    return max(config.synonym_cosine, config.hypernym_cosine)


def is_hyponym(word: str, general: str) -> bool:
    """Return whether a phrase narrows a more general one: "fire truck" has all words of "truck" and more."""
    return set(word.lower().split()) > set(general.lower().split())


def _check_spelling(model: Model, words: Sequence[str]) -> None:
    slips = model.unknown_words(words) if isinstance(model, Speller) else []
    if slips:
        faults = [
            f'no such word: "{word}"' + (f'; did you mean "{meant}"?' if meant else "")
            for word, meant in slips
        ]
        raise BadSetting(f"{' '.join(faults)} (--anyway asks regardless)")


def _vectors(model: Model, words: Sequence[str]) -> Floats:
    vectors = model.embed_text(words)
    empty = [word for word, vector in zip(words, vectors, strict=True) if not vector.any()]
    if empty:
        raise BadSetting(f"{model.name} has no vector for {', '.join(map(repr, empty))}; ask by another word")
    return vectors
