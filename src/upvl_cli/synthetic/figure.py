"""The human body: limbs between joints, clothes, hair; upright ones that walk and seated ones that ride."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.synthetic.bodywork import block, pick, scaled
from upvl_cli.synthetic.mesh import Mesh, Triple, ellipsoid, merge, tube
from upvl_cli.synthetic.model import Part
from upvl_cli.synthetic.surface import DARK, SKIN, Finish, Rgb, cloth

_SKINS: tuple[Rgb, ...] = (SKIN.rgb, (232, 192, 166), (172, 122, 90), (124, 84, 60), (84, 58, 44))
_HAIRS: tuple[Rgb, ...] = ((30, 24, 22), (70, 46, 30), (116, 78, 44), (196, 160, 92), (150, 146, 142))
TOPS: tuple[Rgb, ...] = (
    (190, 36, 40),
    (36, 70, 150),
    (48, 50, 56),
    (226, 224, 216),
    (50, 112, 74),
    (230, 170, 40),
    (120, 92, 150),
    (92, 72, 56),
    (230, 120, 150),
    (90, 150, 190),
)
_TROUSERS: tuple[Rgb, ...] = ((40, 54, 92), (34, 34, 38), (96, 90, 80), (150, 130, 96), (70, 84, 110))


class Appearance(NamedTuple):
    """What somebody looks like.

    Attributes:
        height_m: How tall they are.
        girth: How thick their limbs are, compared with 1.
        head: How big their head is, compared with that of an adult of their height.
    """

    height_m: float
    girth: float
    head: float
    skin: Finish
    hair: Finish
    top: Finish
    trousers: Finish
    shoes: Finish
    long_hair: bool


def look(rng: np.random.Generator, *, child: bool = False) -> Appearance:
    """Somebody by chance."""
    height = rng.uniform(1.0, 1.34) if child else rng.uniform(1.56, 1.94)
    return Appearance(
        height_m=float(height),
        girth=float(rng.uniform(0.9, 1.2)),
        head=1.28 if child else 1.0,
        skin=Finish(pick(rng, _SKINS), 0.45),
        hair=Finish(pick(rng, _HAIRS[:-1] if child else _HAIRS), 0.25),
        top=cloth(pick(rng, TOPS)),
        trousers=cloth(pick(rng, _TROUSERS)),
        shoes=pick(rng, (DARK, cloth((230, 230, 226)), cloth((110, 70, 44)))),
        long_hair=bool(rng.random() < 0.4),
    )


def chain(joints_m: Sequence[Triple], radii_m: Sequence[float], surfaces: Sequence[Finish]) -> Mesh:
    """Return a limb through several joints, each piece with its own cover."""
    return merge(
        tube(joints_m[n], joints_m[n + 1], radii_m[n], surface, end_radius_m=radii_m[n + 1], sides=7)
        for n, surface in enumerate(surfaces)
    )


def head(who: Appearance, neck_m: Triple, helmet: Finish | None = None) -> Mesh:
    """Neck, head, and hair or a helmet; looks forward."""
    x, y, z = neck_m
    size = 0.13 * who.height_m * who.head
    middle = z + 0.028 * who.height_m + size / 2
    parts = [
        tube((x, y, z - 0.03 * who.height_m), (x, y, middle), size * 0.24, who.skin, sides=7),
        ellipsoid((0.8 * size, 0.68 * size, size), (x + 0.01, y, middle), who.skin, sides=10),
    ]
    if helmet:
        cap = (1.12 * size, 0.98 * size, 0.8 * size)
        return merge([*parts, ellipsoid(cap, (x - 0.005, y, middle + 0.26 * size), helmet, sides=10)])
    hair = ellipsoid(
        (0.86 * size, 0.78 * size, 0.78 * size), (x - 0.1 * size, y, middle + 0.18 * size), who.hair
    )
    parts.append(hair)
    if who.long_hair:
        fall = (0.4 * size, 0.74 * size, 1.2 * size)
        parts.append(ellipsoid(fall, (x - 0.3 * size, y, middle - 0.2 * size), who.hair, sides=8))
    return merge(parts)


def torso(who: Appearance, hip_m: Triple, neck_m: Triple, cover: Finish | None = None) -> Mesh:
    """Return the trunk, wider than deep, from the hips to the neck."""
    size, across = who.height_m * who.girth, 1.55
    (x, y, z), (x1, _, z1) = hip_m, neck_m
    waist = (x + 0.45 * (x1 - x), y, z + 0.45 * (z1 - z))
    shoulder = (x + 0.88 * (x1 - x), y, z + 0.88 * (z1 - z))
    radii = (0.066 * size, 0.058 * size, 0.072 * size, 0.03 * size)
    body = chain((hip_m, waist, shoulder, neck_m), radii, (cover or who.top,) * 3)
    seat = tube(
        (x - 0.002, y, z - 0.035 * who.height_m),
        (x + 0.1 * (x1 - x), y, z + 0.1 * (z1 - z)),
        0.069 * size,
        who.trousers,
        sides=8,
    )
    return scaled(merge([body, seat]), (1.0, across, 1.0))


def shoe(who: Appearance, ankle_m: Triple) -> Mesh:
    """Return a shoe below an ankle."""
    x, y, z = ankle_m
    size = 0.145 * who.height_m
    half = 0.26 * size
    return block(
        (x - 0.28 * size, x + 0.72 * size), (y - half, y + half), (z - 0.27 * size, z + 0.1 * size), who.shoes
    )


def walker(
    who: Appearance,
    *,
    stride: float = 0.42,
    arms: bool = True,
    sleeves: bool = True,
    shorts: bool = False,
    x_m: float = 0.0,
    bag: Finish | None = None,
) -> list[Part | Mesh]:
    """Somebody upright, whose legs and arms swing.

    Args:
        who: What they look like.
        stride: How far the legs swing.
        arms: Whether there are arms that swing; otherwise there are none.
        sleeves: Whether the forearms are covered.
        shorts: Whether the shins are bare.
        x_m: How far forward they stand.
        bag: What hangs from the left hand, if anything does.
    """
    tall, thick = who.height_m, who.height_m * who.girth
    hip, neck = (x_m, 0.0, 0.52 * tall), (x_m, 0.0, 0.835 * tall)
    parts: list[Part | Mesh] = [torso(who, hip, neck), head(who, neck)]
    for way, phase in ((1, 0.0), (-1, np.pi)):
        y = way * 0.052 * thick
        ankle = (x_m, y, 0.04 * tall)
        joints = ((x_m, y, 0.51 * tall), (x_m + 0.012, y, 0.28 * tall), ankle)
        shin = who.skin if shorts else who.trousers
        leg = chain(joints, (0.052 * thick, 0.04 * thick, 0.028 * thick), (who.trousers, shin))
        pivot = (x_m, y, 0.51 * tall)
        parts.append(Part(merge([leg, shoe(who, ankle)]), stride, pivot, phase))
        if arms:
            held = bag if way == 1 else None
            parts.append(_arm(who, way, x_m, stride * 0.8, phase + np.pi, sleeves, held))
    return parts


def _arm(
    who: Appearance,
    way: int,
    x_m: float,
    swing_rad: float,
    phase_rad: float,
    sleeves: bool,
    bag: Finish | None,
) -> Part:
    tall, thick = who.height_m, who.height_m * who.girth
    y, out = way * 0.118 * thick, way * 0.13 * thick
    joints = (
        (x_m, y, 0.805 * tall),
        (x_m - 0.01, out, 0.63 * tall),
        (x_m + 0.03 * tall, out, 0.48 * tall),
    )
    radii = (0.034 * thick, 0.027 * thick, 0.02 * thick)
    parts = [chain(joints, radii, (who.top, who.top if sleeves else who.skin))]
    size = 0.055 * tall
    x, _, z = joints[2]
    parts.append(ellipsoid((size * 0.7, size * 0.5, size), (x, out, z - size * 0.3), who.skin, sides=6))
    if bag:
        low = z - 0.19 * tall
        parts.append(block((x - 0.15, x + 0.15), (out - 0.04, out + 0.04), (low, z - 0.055 * tall), bag))
        parts.append(block((x - 0.06, x + 0.06), (out - 0.012, out + 0.012), (low, z - 0.03 * tall), DARK))
    return Part(merge(parts), swing_rad, joints[0], phase_rad)


def reach(who: Appearance, x_m: float, shoulder_z_m: float, hand_m: Triple) -> Mesh:
    """Both arms, from the shoulders to something held; the place is that of the left hand."""
    thick = who.height_m * who.girth
    parts = []
    for way in (1, -1):
        start = np.array([x_m, way * 0.115 * thick, shoulder_z_m])
        end = np.array([hand_m[0], way * hand_m[1], hand_m[2]])
        middle = (start + end) / 2 + np.array([-0.01, way * 0.04, -0.06])
        joints: list[Triple] = [(float(p[0]), float(p[1]), float(p[2])) for p in (start, middle, end)]
        parts.append(chain(joints, (0.034 * thick, 0.027 * thick, 0.02 * thick), (who.top, who.top)))
        parts.append(ellipsoid((0.09, 0.07, 0.07), joints[2], who.skin, sides=6))
    return merge(parts)


def seated_leg(who: Appearance, hip_m: Triple, knee_m: Triple, ankle_m: Triple) -> Mesh:
    """Return a bent leg with its shoe."""
    thick = who.height_m * who.girth
    radii = (0.05 * thick, 0.04 * thick, 0.028 * thick)
    leg = chain((hip_m, knee_m, ankle_m), radii, (who.trousers, who.trousers))
    return merge([leg, shoe(who, ankle_m)])
