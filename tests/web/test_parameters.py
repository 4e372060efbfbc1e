"""Query strings: what they ask for, and the one line for each that asks nothing sensible."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upvl_cli.errors import BadSetting
from upvl_cli.web.parameters import CLASSES, MOTIONS, Asked, Question, encode, parse


def test_nothing_is_asked_by_an_empty_form() -> None:
    assert parse(b"") == parse(b"q=&max_speed=&drive=&threshold=") == Asked(Question())


def test_all_fields() -> None:
    asked = parse(
        b"q=bus%2C+fire+truck%2Cbus&not=car&source=labels&anyway=1&drive=b&drive=a&class=vehicle&motion=moving"
        b"&min_speed=1&max_speed=9.5&max_range=40&from=1&to=2&min_score=.5&relation=near&other=car&within=3&stand=4"
        b"&candidates=200&like=a%3A3%3A4&threshold=0.3&page=2&at=7"
    )
    assert asked == Asked(
        Question(
            source="labels", words=("bus", "fire truck"), negatives=("car",), anyway=True, segments=("a", "b"),
            class_name="vehicle", motion="moving", min_speed=1, max_speed=9.5, max_range=40, from_s=1, to_s=2,
            min_score=0.5, relation="near", other=("car",), within=3, stand=4, candidates=200,
            similar_to=("a", 3, 4),
        ),
        True, 0.3, 2, 7,
    )  # fmt: skip
    assert parse(encode(asked).encode()) == asked


NUMBERS = st.one_of(st.none(), st.integers(0, 900).map(float))


@given(
    st.builds(
        Question,
        words=st.lists(st.sampled_from(["car", "fire truck", "à la carte", "<b>&=?#%"]), unique=True).map(
            tuple
        ),
        class_name=st.sampled_from(CLASSES),
        motion=st.sampled_from(MOTIONS),
        min_speed=NUMBERS,
        to_s=NUMBERS,
        within=st.integers(0, 99).map(float),
    ),
    st.integers(1, 50),
)
def test_what_is_encoded_is_parsed_again(question: Question, page: int) -> None:
    text = encode(Asked(question, page=page))
    assert parse(text.encode()).question == question
    assert parse(text.encode()).page == page


@pytest.mark.parametrize(
    ("query", "message"),
    [
        (b"q=a&q=b", "the field 'q' is given twice"),
        (b"colour=red", "the field 'colour' is unknown"),
        (b"q=%ff", "not encoded in UTF-8"),
        (b"q=\xff", "not encoded in UTF-8"),
        (b"q=a%00b", "holds a control character"),
        (b"q=" + b"a" * 5000, "expected at most 4096"),
        (b"&".join(b"f%d=1" % n for n in range(70)), "more than 60 fields"),
        (b"q=" + b"a" * 90, "expected at most 20 phrases of 80 letters"),
        (b"q=" + b",".join(b"w%d" % n for n in range(21)), "expected at most 20 phrases"),
        (b"max_speed=fast", "max_speed is 'fast'; expected a number from 0 to 1000"),
        (b"max_speed=nan", "expected a number"),
        (b"max_speed=inf", "expected a number"),
        (b"max_speed=1e999", "expected a number"),
        (b"max_speed=-1", "expected a number"),
        (b"max_speed=1_0", "expected a number"),
        (b"max_speed=%D9%A3", "expected a number"),
        (b"page=0", "page is '0'; expected a whole number from 1"),
        (b"page=99999999999999999999", "expected a whole number"),
        (b"page=1.5", "expected a whole number"),
        (b"source=../labels", "source is '../labels'; expected one of: nothing, labels, detections"),
        (b"candidates=10000000", "expected one of"),
        (b"like=a:b:c", "expected DRIVE:FRAME:BOX"),
        (b"q=car&relation=near", "the relation near needs another object"),
    ],
)
def test_what_cannot_be_asked_is_one_line(query: bytes, message: str) -> None:
    with pytest.raises(BadSetting) as caught:
        parse(query)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300
