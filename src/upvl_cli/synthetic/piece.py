"""What stands in the city for good."""

from __future__ import annotations

from typing import NamedTuple

from upvl_cli.synthetic.mesh import Mesh


class Piece(NamedTuple):
    """Something that never moves, in world axes.

    Attributes:
        name: What it is, one of `STUFF`.
        mesh: Its triangles.
    """

    name: str
    mesh: Mesh


# What the city is made of beside its objects, and what people call it.
STUFF: dict[str, tuple[str, ...]] = {
    "road": ("street", "asphalt", "roadway"),
    "lane marking": ("road marking", "white line"),
    "crosswalk": ("zebra crossing", "pedestrian crossing"),
    "kerb": ("curb",),
    "pavement": ("sidewalk", "footpath"),
    "grass": ("lawn", "verge", "terrain"),
    "building": ("block of flats", "office building", "facade"),
    "house": ("home", "cottage"),
    "wall": ("brick wall", "stone wall"),
    "fence": ("railing", "wooden fence"),
    "hedge": ("bush", "shrub"),
    "tree": ("trunk", "foliage", "vegetation"),
    "pole": ("post", "column"),
    "street light": ("lamp post", "street lamp"),
    "traffic sign": ("road sign", "sign"),
    "traffic light": ("stop light", "signal"),
    "bus stop": ("bus shelter", "shelter"),
}
