"""What a page is asked for, read from the query string of its address: strict, bounded, one line for what is wrong."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from urllib.parse import parse_qsl, urlencode

from upvl_cli.errors import BadSetting

MAX_QUERY_BYTES = 4096
MAX_FIELDS = 60
MAX_PHRASES = 20
MAX_PHRASE_LETTERS = 80
MAX_NUMBER = 1e6
MAX_PAGE = 100_000
CANDIDATES = (50, 200, 1000)
RELATIONS = ("", "near", "overtaking", "stopped")
CLASSES = ("", "vehicle", "pedestrian", "cyclist", "other", "unknown")
SOURCES = ("labels", "detections")
MOTIONS = ("", "moving", "parked")
PER_PAGE = 12


@dataclass(frozen=True)
class Question:
    """What objects are looked for; two equal questions have one answer.

    Attributes:
        source: "labels", "detections", or "" for detections where there are any.
        words: Phrases; none looks for objects by the other fields alone.
        negatives: Phrases that compete instead of the default ones; none takes these.
        anyway: Whether words that are likely misspelt are accepted.
        segments: Names of the drives; none takes all.
        class_name: Class of the labels; "" for any.
        motion: "moving", "parked", or "" for both.
        min_speed: Minimum horizontal speed over the ground (m/s).
        max_speed: Maximum horizontal speed over the ground (m/s).
        max_range: Maximum horizontal distance from the car (m).
        from_s: Earliest time since the first frame of the drive (s).
        to_s: Latest time since the first frame of the drive (s).
        min_score: Minimum score of the box itself.
        relation: "near", "overtaking", "stopped", or "" for none.
        other: Phrases of the other object of a relation.
        within: Largest gap to the other object, or its largest distance to the side (m).
        stand: Shortest time that a stopped object stands (s).
        candidates: How many of the best-ranked tracks are classified.
        similar_to: Drive, frame and row of the box that others are to be like; () for none.
    """

    source: str = ""
    words: tuple[str, ...] = ()
    negatives: tuple[str, ...] = ()
    anyway: bool = False
    segments: tuple[str, ...] = ()
    class_name: str = ""
    motion: str = ""
    min_speed: float | None = None
    max_speed: float | None = None
    max_range: float | None = None
    from_s: float | None = None
    to_s: float | None = None
    min_score: float | None = None
    relation: str = ""
    other: tuple[str, ...] = ()
    within: float = 5.0
    stand: float = 2.0
    candidates: int = CANDIDATES[0]
    similar_to: tuple[str, int, int] | tuple[()] = ()


@dataclass(frozen=True)
class Asked:
    """A question and how its answer is shown.

    Attributes:
        question: The question.
        is_asked: Whether there is one: without any field the page shows the empty form.
        threshold: Minimum score of a hit; None takes that of query.toml.
        page: Number of the page, from 1 on.
        at: Frame that the page of a hit shows; None takes the frame of the hit.
    """

    question: Question
    is_asked: bool = False
    threshold: float | None = None
    page: int = 1
    at: int | None = None

    def address(self, **changes: object) -> str:
        """Return the query string of this question, with some fields replaced.

        Args:
            changes: `threshold`, `page`, `at`, or fields of `Question`.
        """
        shown = {name: changes.pop(name) for name in ("threshold", "page", "at") if name in changes}
        return encode(replace(self, question=replace(self.question, **changes), **shown))  # type: ignore[arg-type]


def parse(query: bytes) -> Asked:
    """Return what a query string asks for.

    Args:
        query: The raw bytes after the question mark.

    Raises:
        BadSetting: A field is unknown, given twice, no text, no number, or out of range.
    """
    fields = _fields(query)
    taken = _Fields(fields)
    question = Question(
        source=taken.choice("source", ("", *SOURCES)),
        words=taken.phrases("q"),
        negatives=taken.phrases("not"),
        anyway=taken.choice("anyway", ("", "1")) == "1",
        segments=taken.names("drive"),
        class_name=taken.choice("class", CLASSES),
        motion=taken.choice("motion", MOTIONS),
        min_speed=taken.number("min_speed", 0, 1000),
        max_speed=taken.number("max_speed", 0, 1000),
        max_range=taken.number("max_range", 0, 10_000),
        from_s=taken.number("from", 0, MAX_NUMBER),
        to_s=taken.number("to", 0, MAX_NUMBER),
        min_score=taken.number("min_score", 0, 1),
        relation=taken.choice("relation", RELATIONS),
        other=taken.phrases("other"),
        within=_given(taken.number("within", 0, 1000), 5.0),
        stand=_given(taken.number("stand", 0, 10_000), 2.0),
        candidates=int(taken.choice("candidates", ("", *map(str, CANDIDATES))) or CANDIDATES[0]),
        similar_to=taken.box("like"),
    )
    page, at = taken.integer("page", 1, MAX_PAGE), taken.integer("at", 0, 2**31)
    asked = Asked(
        question, bool(taken.given), taken.number("threshold", 0, 1), 1 if page is None else page, at
    )
    taken.refuse_unknown()
    _check_relation(question)
    return asked


def _fields(query: bytes) -> dict[str, str]:
    if len(query) > MAX_QUERY_BYTES:
        raise BadSetting(
            f"the question has {len(query)} bytes; expected at most {MAX_QUERY_BYTES}: ask for fewer words"
        )
    try:
        pairs = parse_qsl(
            query.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=MAX_FIELDS
        )
    except UnicodeError:
        raise BadSetting("the question is not encoded in UTF-8; type it into the form") from None
    except ValueError:
        raise BadSetting(f"the question has more than {MAX_FIELDS} fields; use the form") from None
    found: dict[str, str] = {}
    for name, value in pairs:
        if name in found and name != "drive":
            raise BadSetting(f"the field {_shown(name)} is given twice; give it once")
        if any(ord(letter) < 32 or ord(letter) == 127 for letter in name + value):
            raise BadSetting(
                f"the field {_shown(name)} holds a control character; expected a line of plain text"
            )
        found[name] = f"{found[name]},{value}" if name in found and found[name] else value
    return found


def _shown(text: str) -> str:
    """Return a part of a text from outside that is safe in a message of one line."""
    return repr(text[:40])


def _given(value: float | None, default: float) -> float:
    return default if value is None else value


def _check_relation(question: Question) -> None:
    if question.relation in ("near", "overtaking") and not question.other:
        raise BadSetting(
            f"the relation {question.relation} needs another object; name it in the field Other object"
        )


class _Fields:
    """Fields of a query string, taken one by one; an empty one counts as not given."""

    def __init__(self, fields: Mapping[str, str]) -> None:
        self.given = {name: value.strip() for name, value in fields.items() if value.strip()}
        self._unknown = set(fields)

    def _take(self, name: str) -> str:
        self._unknown.discard(name)
        return self.given.get(name, "")

    def choice(self, name: str, choices: Collection[str]) -> str:
        value = self._take(name)
        if value not in choices:
            expected = ", ".join(choice or "nothing" for choice in choices)
            raise BadSetting(f"{name} is {_shown(value)}; expected one of: {expected}")
        return value

    def phrases(self, name: str) -> tuple[str, ...]:
        phrases = tuple(dict.fromkeys(part.strip() for part in self._take(name).split(",") if part.strip()))
        if len(phrases) > MAX_PHRASES or any(len(phrase) > MAX_PHRASE_LETTERS for phrase in phrases):
            raise BadSetting(
                f"{name} holds too much; expected at most {MAX_PHRASES} phrases of {MAX_PHRASE_LETTERS} letters each"
            )
        return phrases

    def names(self, name: str) -> tuple[str, ...]:
        return tuple(sorted({part.strip() for part in self._take(name).split(",") if part.strip()}))

    def number(self, name: str, low: float, high: float) -> float | None:
        text = self._take(name)
        if not text:
            return None
        try:
            value = float(text) if len(text) <= 30 and text.isascii() and "_" not in text else math.nan
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise BadSetting(f"{name} is {_shown(text)}; expected a number from {low:g} to {high:g}")
        return value + 0.0  # without the sign of a zero

    def integer(self, name: str, low: int, high: int) -> int | None:
        text = self._take(name)
        if not text:
            return None
        if not (text.isascii() and text.isdigit() and len(text) <= 10 and low <= int(text) <= high):
            raise BadSetting(f"{name} is {_shown(text)}; expected a whole number from {low} to {high}")
        return int(text)

    def box(self, name: str) -> tuple[str, int, int] | tuple[()]:
        text = self._take(name)
        if not text:
            return ()
        segment, _, rest = text.partition(":")
        frame, _, box = rest.partition(":")
        if not all(part.isascii() and part.isdigit() and len(part) <= 9 for part in (frame, box)):
            raise BadSetting(f"{name} is {_shown(text)}; expected DRIVE:FRAME:BOX, as the pages link it")
        return segment, int(frame), int(box)

    def refuse_unknown(self) -> None:
        if self._unknown:
            name = min(self._unknown)
            raise BadSetting(f"the field {_shown(name)} is unknown; use the fields of the form")


def encode(asked: Asked) -> str:
    """Return the query string that `parse` reads as this; fields that have their default are left out."""
    question, default = asked.question, Question()
    texts = {
        "q": ", ".join(question.words),
        "not": ", ".join(question.negatives),
        "source": question.source,
        "anyway": "1" if question.anyway else "",
        "drive": ",".join(question.segments),
        "class": question.class_name,
        "motion": question.motion,
        "min_speed": _number(question.min_speed),
        "max_speed": _number(question.max_speed),
        "max_range": _number(question.max_range),
        "from": _number(question.from_s),
        "to": _number(question.to_s),
        "min_score": _number(question.min_score),
        "relation": question.relation,
        "other": ", ".join(question.other),
        "within": "" if question.within == default.within else _number(question.within),
        "stand": "" if question.stand == default.stand else _number(question.stand),
        "candidates": "" if question.candidates == default.candidates else str(question.candidates),
        "like": ":".join(map(str, question.similar_to)),
        "threshold": _number(asked.threshold),
        "page": "" if asked.page == 1 else str(asked.page),
        "at": "" if asked.at is None else str(asked.at),
    }
    return urlencode({name: text for name, text in texts.items() if text})


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
