"""What light does on a surface: its colour and pattern in a picture, its return to a LiDAR."""

from __future__ import annotations

from typing import NamedTuple

Rgb = tuple[int, int, int]


class Finish(NamedTuple):
    """A material.

    Attributes:
        rgb: Colour in a picture, 0 to 255.
        reflectance: Intensity of a LiDAR return that meets it head on, 0 to 1.
        dropout: Share of LiDAR rays that give no return.
        depth_m: How far a ray may go in before it comes back, as in leaves.
        texture: Pattern in a picture, one of `textures.TEXTURES`.
        gloss: How much of the sky it mirrors, 0 to 1.
    """

    rgb: Rgb
    reflectance: float
    dropout: float = 0.02
    depth_m: float = 0.0
    texture: str = "plain"
    gloss: float = 0.0


def paint(rgb: Rgb) -> Finish:
    """Return the lacquer of a vehicle; dark colours hardly answer a LiDAR."""
    brightness = sum(rgb) / (3 * 255)
    return Finish(rgb, 0.08 + 0.55 * brightness, 0.12 - 0.1 * brightness, gloss=0.25)


def cloth(rgb: Rgb) -> Finish:
    """Return what people wear."""
    return Finish(rgb, 0.2 + 0.4 * sum(rgb) / (3 * 255), texture="cloth")


GLASS = Finish((58, 70, 82), 0.15, 0.45, gloss=0.6)
RUBBER = Finish((34, 34, 36), 0.06, 0.15)
STEEL = Finish((128, 132, 136), 0.45, gloss=0.2)
CHROME = Finish((190, 194, 198), 0.6, gloss=0.6)
DARK = Finish((40, 42, 46), 0.1, 0.1)
SKIN = Finish((206, 162, 134), 0.45)
HEADLIGHT = Finish((244, 240, 220), 0.9, gloss=0.3)
TAILLIGHT = Finish((176, 24, 28), 0.8)
PLATE = Finish((236, 236, 230), 0.95, 0.0)
ASPHALT = Finish((92, 92, 96), 0.12, 0.04, texture="asphalt")
MARKING = Finish((222, 222, 216), 0.75, texture="worn")
KERB = Finish((168, 166, 160), 0.3, texture="concrete")
PAVEMENT = Finish((150, 146, 140), 0.25, texture="slabs")
GRASS = Finish((98, 132, 66), 0.35, 0.03, 0.03, texture="grass")
BRICK = Finish((152, 92, 74), 0.35, texture="bricks")
PLASTER = Finish((208, 196, 168), 0.5, texture="plaster")
CONCRETE = Finish((160, 160, 154), 0.3, texture="concrete")
WOOD = Finish((138, 104, 70), 0.35, texture="planks")
TILES = Finish((142, 74, 56), 0.3, texture="tiles")
BARK = Finish((92, 72, 54), 0.25, texture="bark")
LEAVES = Finish((58, 104, 44), 0.4, 0.08, 0.35, texture="leaves")
