"""A query of a script, from its named options."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from upvl_cli.errors import BadSetting
from upvl_cli.query.classes import classes_from_phrases
from upvl_cli.query.config import QueryConfig
from upvl_cli.query.filters import Filters
from upvl_cli.query.run import Request

_FILTERS = tuple(field.name for field in fields(Filters))
_PRINTED_ONLY = {"top", "sheet_objects", "suggest"}  # of the table and the picture that a command shows
_SETTINGS = tuple(field.name for field in fields(QueryConfig) if field.name not in _PRINTED_ONLY)
_OTHERS = ("on", "check_spelling")


def request_of(phrases: str | Sequence[str], options: Mapping[str, Any]) -> Request:
    """Return the request of some phrases.

    Args:
        phrases: Phrases, or one text with commas between them.
        options: Filters, settings of query.toml, `on` and `check_spelling`, by their names.

    Raises:
        BadSetting: An option is unknown.
    """
    known = (*_FILTERS, *_OTHERS, *_SETTINGS)
    for name in options:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise BadSetting(f"query has no option {name!r}{hint} (known: {', '.join(known)})")
    classes = classes_from_phrases([phrases] if isinstance(phrases, str) else phrases)
    segments = options.get("segments", ())
    filters = {name: options[name] for name in _FILTERS if name in options and name != "segments"}
    return Request(
        classes=classes,
        name=" ".join(classes.words),
        source=options.get("on"),
        filters=Filters(segments=(segments,) if isinstance(segments, str) else segments, **filters),
        sheet=False,
        check_spelling=options.get("check_spelling", True),
        values={name: options[name] for name in _SETTINGS if name in options},
    )
