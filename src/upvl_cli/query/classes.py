"""What is asked for: classes of words, from phrases or from a TOML file."""

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
    """Classes of words.

    Attributes:
        words: The words of each class, by its name.
        negatives: What they compete with; None leaves that to the settings of the workspace.
    """

    words: dict[str, tuple[str, ...]]
    negatives: tuple[str, ...] | None

    @property
    def all_words(self) -> tuple[str, ...]:
        """The words of all classes, in order."""
        return tuple(word for some in self.words.values() for word in some)


def of_phrases(phrases: Sequence[str]) -> Classes:
    """One class a phrase; commas part several phrases.

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


def of_file(path: Path) -> Classes:
    """The classes of a TOML file: a table each, with its words, and perhaps negatives.

    Raises:
        BadSetting: The file is missing or is no such file; all faults in one message.
    """
    if not path.is_file():
        raise BadSetting(f"{path} is missing; expected a file of classes, for example: {EXAMPLE}")
    tables = read_toml(path)
    # TOML takes a list that follows a table for the table's own: both places mean the same.
    negatives = {"negatives": tables.pop("negatives", [])}
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
    faults += [fault for name, some in words.items() for fault in _faults(f"{name}.words", some, least=1)]
    faults += [fault for name, some in negatives.items() for fault in _faults(name, some, least=0)]
    if not faults:
        against = tuple(word.strip() for some in negatives.values() for word in some)
        classes = Classes(
            {name: tuple(word.strip() for word in some) for name, some in words.items()}, against or None
        )
        faults = _twice([*classes.all_words, *against])
    if faults:
        raise BadSetting(f"{path}: {'; '.join(faults)}")
    return classes


def _faults(name: str, words: Any, *, least: int) -> list[str]:
    if not isinstance(words, list) or len(words) < least:
        return [f"{name} must be a list of words"]
    if not all(isinstance(word, str) and word.strip() for word in words):
        return [f"{name} must be texts, none of them empty"]
    return []


def _twice(words: Sequence[str]) -> list[str]:
    return [
        f"{word!r} stands {times} times; a word can be one thing only"
        for word, times in Counter(words).items()
        if times > 1
    ]
