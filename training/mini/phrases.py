"""The phrases that get a vector of the full model: nouns of the street, and what people say about them."""

from __future__ import annotations

import tomllib
from pathlib import Path

WORDS = Path(__file__).with_name("words.toml")
NOUNS = Path(__file__).with_name("nouns.txt")
COLOURS = ("red", "blue", "green", "yellow", "white", "black", "grey", "silver", "orange", "brown")
STATES = ("parked", "moving", "small", "large", "old", "broken", "empty", "stopped")
COLOURED = (
    "car", "truck", "van", "bus", "taxi", "pickup truck", "motorcycle", "bicycle", "house", "building", "tram",
    "fire truck", "umbrella", "traffic cone", "trash can", "mailbox", "sign", "bench", "ambulance", "tractor", "suv",
)  # fmt: skip
PEOPLE = ("person", "man", "woman", "child", "pedestrian", "cyclist", "worker", "police officer")
DOING = (
    "walking", "standing", "running", "sitting", "crossing the street", "riding a bicycle", "riding a motorcycle",
    "waiting", "pushing a stroller", "pushing a shopping cart", "carrying a bag", "with a backpack", "with a dog",
    "with an umbrella", "in a wheelchair", "on a scooter", "on a skateboard", "in a red jacket", "in a yellow vest",
    "with a suitcase", "on a bench", "on the sidewalk", "on the road", "with a helmet", "wearing a hat",
)  # fmt: skip
WHERE = (
    "on the road",
    "on the sidewalk",
    "by the roadside",
    "in a driveway",
    "at the kerb",
    "with open doors",
)


def phrases() -> list[str]:
    """All phrases, each once, in a fixed order."""
    concepts = tomllib.loads(WORDS.read_text(encoding="utf-8")).values()
    found = [word for concept in concepts for word in (*concept["words"], *concept["test"])]
    found += [line for line in NOUNS.read_text(encoding="utf-8").splitlines() if line]
    found += [f"{colour} {noun}" for noun in COLOURED for colour in (*COLOURS, *STATES)]
    found += [f"{who} {doing}" for who in PEOPLE for doing in DOING]
    found += [f"{noun} {where}" for noun in COLOURED for where in WHERE]
    return list(dict.fromkeys(found))
