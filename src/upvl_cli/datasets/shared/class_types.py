"""Waymo's type of a class by the name that people give it, for data without a fixed list of classes."""

from __future__ import annotations

import re

VEHICLE, PEDESTRIAN, SIGN, CYCLIST = 1, 2, 3, 4

# The first of these whose word is in the name decides: a "bicycle rider" is a cyclist, not a pedestrian.
_WORDS: tuple[tuple[int, tuple[str, ...]], ...] = (
    (0, ("rack", "barrier", "cone", "depiction", "animal", "debris", "misc", "dontcare", "other object")),
    (CYCLIST, ("cyclist", "bicyclist", "bicycle", "bike rider", "bicycle rider")),
    (
        VEHICLE,
        (
            *(
                "vehicle",
                "car",
                "truck",
                "lorry",
                "bus",
                "van",
                "tram",
                "train",
                "trailer",
                "motorcycle",
                "motorcyclist",
            ),
            *(
                "motorbike",
                "moped",
                "motor",
                "taxi",
                "pickup",
                "suv",
                "tractor",
                "excavator",
                "ambulance",
                "coach",
            ),
            *("forklift", "tricycle", "auto", "rickshaw", "scooter rider"),
        ),
    ),
    (CYCLIST, ("bike",)),
    (
        PEDESTRIAN,
        (
            "pedestrian",
            "person",
            "people",
            "human",
            "adult",
            "child",
            "walker",
            "wheelchair",
            "stroller",
            "rider",
        ),
    ),
    (SIGN, ("sign",)),
)


def type_of_class(name: str) -> int:
    """Return VEHICLE 1, PEDESTRIAN 2, SIGN 3 or CYCLIST 4 for the name of a class, 0 for anything else.

    Args:
        name: For example "Car", "vehicle.truck", "PEDESTRIAN", "otherVehicle".
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    text = " ".join(re.findall(r"[a-z]+", spaced.lower()))
    for kind, words in _WORDS:
        if any(re.search(rf"\b{word}s?\b", text) for word in words):
            return kind
    return 0
