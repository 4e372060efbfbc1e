"""Who asks for a bus asks for school buses, too: the kinds of what is queried, by the words that upvl knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from upvl_cli.query.classes import Classes
from upvl_cli.query.vocabulary import is_hyponym
from upvl_cli.stages.classify import ClassifyConfig

# Other names of the lists of classify.toml.
_LIST_NAMES = {
    "vehicle": ("vehicle", "motor vehicle"),
    "pedestrian": ("pedestrian", "person", "human", "people"),
    "cyclist": ("cyclist", "bicyclist"),
}


def with_kinds(classes: Classes, config: ClassifyConfig) -> Classes:
    """Return the classes with the kinds of their words as further words.

    A kind of a word is a phrase of `classify.toml` that narrows it ("school bus" for "bus"), or any word of a list
    that is asked by its name or a synonym ("child" for "person"). A word that a class asks for itself stays that
    class's. Classes with negatives of their own are taken as they are.
    """
    if classes.negatives is not None:
        return classes
    taken = set(classes.all_words)
    extended: dict[str, tuple[str, ...]] = {}
    for name, words in classes.words.items():
        kinds = [kind for kind in _kinds(words, config) if kind not in taken]
        taken.update(kinds)
        extended[name] = (*words, *kinds)
    return replace(classes, words=extended)


def _kinds(words: Sequence[str], config: ClassifyConfig) -> list[str]:
    finer = {
        "vehicle": config.kinds.vehicle,
        "pedestrian": config.kinds.pedestrian,
        "cyclist": config.kinds.cyclist,
    }
    plain = {word.lower() for word in words}
    found: list[str] = []
    for name, kinds in finer.items():
        every = (*config.lists[name], *kinds)
        if plain & set(_LIST_NAMES[name]):
            found += every
        else:
            found += [kind for kind in every if any(is_hyponym(kind, word) for word in words)]
    return list(dict.fromkeys(found))
