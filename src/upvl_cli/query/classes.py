"""The classes of a query: words from phrases or from a TOML file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upvl_cli.config.toml import read_toml
from upvl_cli.errors import BadSetting

EXAMPLE = '[truck] words = ["truck", "lorry"]'


@dataclass(frozen=True)
class Classes:
    """Classes, each described by one or more words.

    Attributes:
        words: The words of each class, by its name.
        negatives: Words of other things, which compete with the classes; None takes the default negatives.
    """

    words: dict[str, tuple[str, ...]]
    negatives: tuple[str, ...] | None

    @property
    def all_words(self) -> tuple[str, ...]:
        """The words of all classes, in order."""
        return tuple(word for class_words in self.words.values() for word in class_words)


def classes_from_phrases(phrases: Sequence[str]) -> Classes:
    """Return one class for each phrase; a comma separates phrases.

    Raises:
        BadSetting: There is no phrase, or an empty one.
    """
    split = [part.strip() for phrase in phrases for part in phrase.split(",")]
    if not split:
        raise BadSetting('nothing is asked for; name it: upvl query "fire truck", or --classes FILE.toml')
    if not all(split):
        raise BadSetting(
            'an empty phrase is asked for; expected words between commas, for example "car, fire truck"'
        )
    return Classes({phrase: (phrase,) for phrase in split}, None)


def classes_from_file(path: Path) -> Classes:
    """Return the classes of a TOML file: one table a class with its words, and optional negatives.

    Raises:
        BadSetting: The file is missing or has another form; all faults in one message.
    """
    if not path.is_file():
        raise BadSetting(f"{path} is missing; expected a file of classes, for example: {EXAMPLE}")
    tables = read_toml(path)
    # TOML reads a list that follows a table as part of that table: both positions mean the same here.
    negatives: dict[str, Any] = {"negatives": tables.pop("negatives", [])}
    words: dict[str, Any] = {}
    faults = [] if tables else [f"it has no class; expected for example: {EXAMPLE}"]
    for name, table in tables.items():
        if not isinstance(table, dict):
            faults.append(f"{name} is no table with words, such as {EXAMPLE}")
            continue
        unknown = [f"{name}.{key}" for key in table if key not in ("words", "negatives")]
        faults += [f"unknown key {key} (known: words, negatives)" for key in unknown]
        words[name] = table.get("words", [])
        negatives[f"{name}.negatives"] = table.get("negatives", [])
    faults += [fault for name, listed in words.items() for fault in _list_faults(f"{name}.words", listed, 1)]
    faults += [fault for name, listed in negatives.items() for fault in _list_faults(name, listed, 0)]
    if not faults:
        negative_words = tuple(word.strip() for listed in negatives.values() for word in listed)
        classes = Classes(
            {name: tuple(word.strip() for word in listed) for name, listed in words.items()},
            negative_words or None,
        )
        faults = _duplicate_faults([*classes.all_words, *negative_words])
    if faults:
        raise BadSetting(f"{path}: {'; '.join(faults)}")
    return classes


def _list_faults(name: str, words: Any, min_words: int) -> list[str]:
    if not isinstance(words, list) or len(words) < min_words:
        return [f"{name} must be a list of words"]
    if not all(isinstance(word, str) and word.strip() for word in words):
        return [f"{name} must be texts, none of them empty"]
    return []


def _duplicate_faults(words: Sequence[str]) -> list[str]:
    return [
        f"{word!r} stands {times} times; a word can be one thing only"
        for word, times in Counter(words).items()
        if times > 1
    ]
