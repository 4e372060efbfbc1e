"""What vehicles and street furniture have in common: bodies with panels on them, wheels, blocks, chance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from upvl_cli.synthetic.mesh import Mesh, Pair, Triple, box, merge, of, prism, tube
from upvl_cli.synthetic.model import ObjectModel, Part, model
from upvl_cli.synthetic.surface import CHROME, DARK, RUBBER, Finish

T = TypeVar("T")
LIFT_M = 0.008  # how far a panel stands out of what it lies on, so that rays never tie
_DEPTH_M = 0.05  # how far it goes into it


def pick(rng: np.random.Generator, options: Sequence[T]) -> T:
    """One of several, all equally likely."""
    return options[int(rng.integers(len(options)))]


def block(x_m: Pair, y_m: Pair, z_m: Pair, surface: Finish) -> Mesh:
    """Return a box between bounds."""
    (x, x1), (y, y1), (z, z1) = x_m, y_m, z_m
    return box((x1 - x, y1 - y, z1 - z), ((x + x1) / 2, (y + y1) / 2, (z + z1) / 2), surface)


def both(x_m: Pair, y_m: Pair, z_m: Pair, surface: Finish) -> Mesh:
    """Return a box on the left and the same on the right."""
    low, high = y_m
    return merge([block(x_m, (low, high), z_m, surface), block(x_m, (-high, -low), z_m, surface)])


def scaled(mesh: Mesh, factor: Triple) -> Mesh:
    """Return the same, longer, wider or higher."""
    return Mesh(mesh.corner_m * np.array(factor), mesh.face, mesh.surface, mesh.surfaces)


def varied(rng: np.random.Generator, parts: Sequence[Part | Mesh], spread: float = 0.04) -> ObjectModel:
    """Return a model a little longer, wider and higher than drawn, or less, by chance."""
    factor = 1 + rng.uniform(-spread, spread) * 0.6 + rng.uniform(-spread, spread, 3) * 0.4
    along, across, up = (float(v) for v in factor)
    resized = []
    for part in parts:
        moved = part if isinstance(part, Part) else Part(part)
        x, y, z = moved.pivot_m
        mesh = scaled(moved.mesh, (along, across, up))
        resized.append(moved._replace(mesh=mesh, pivot_m=(x * along, y * across, z * up)))
    return model(resized)


def rectangle(x_m: Pair, z_m: Pair) -> tuple[Pair, ...]:
    """Return the side view of a box."""
    return ((x_m[0], z_m[0]), (x_m[1], z_m[0]), (x_m[1], z_m[1]), (x_m[0], z_m[1]))


class Shell(NamedTuple):
    """A body: its side view drawn out across, narrower at the top; panels can be laid on it.

    Attributes:
        outline_xz_m: Side view, counter-clockwise with x right and z up.
        width_m: Full width at the lowest point.
        inset_m: How much narrower each side is at the highest point.
    """

    outline_xz_m: tuple[Pair, ...]
    width_m: float
    inset_m: float = 0.0

    def mesh(self, surface: Finish) -> Mesh:
        """Return the body itself."""
        return prism(self.outline_xz_m, self.width_m, surface, self.inset_m)

    def half_m(self, z_m: float) -> float:
        """Half its width at a height."""
        heights = [z for _, z in self.outline_xz_m]
        low, high = min(heights), max(heights)
        return self.width_m / 2 - self.inset_m * (z_m - low) / (high - low)

    def end_m(self, z_m: float, way: int) -> float:
        """Where its front (way 1) or rear (way -1) is at a height."""
        start = np.array(self.outline_xz_m)
        end = np.roll(start, -1, axis=0)
        low, high = np.minimum(start, end)[:, 1], np.maximum(start, end)[:, 1]
        met = (low <= z_m) & (z_m <= high) & (high > low)
        share = (z_m - start[met, 1]) / (end[met, 1] - start[met, 1])
        places = start[met, 0] + share * (end[met, 0] - start[met, 0])
        return float(way * (way * places).max())

    def side(self, outline_xz_m: Sequence[Pair], surface: Finish, lift_m: float = LIFT_M) -> Mesh:
        """Return a panel on the left and on the right."""
        heights = [z for _, z in outline_xz_m]
        low, high = self.half_m(min(heights)), self.half_m(max(heights))
        return prism(outline_xz_m, 2 * (low + lift_m), surface, low - high)

    def window(self, span: Pair, z_m: Pair, surface: Finish, lift_m: float = LIFT_M) -> Mesh:
        """Return a panel on both sides, slanted as the ends are; its span is 0 at the rear and 1 at the front."""
        corners = []
        for share, z in ((0, 0), (1, 0), (1, 1), (0, 1)):
            rear, front = self.end_m(z_m[z], -1), self.end_m(z_m[z], 1)
            corners.append((rear + (front - rear) * span[share], z_m[z]))
        return self.side(corners, surface, lift_m)

    def _slab(self, z_m: Pair, way: int, lift_m: float, depth_m: float) -> list[Pair]:
        outer = [self.end_m(z, way) for z in z_m]
        near, far = sorted((-way * depth_m, way * lift_m))
        return [(outer[0] + near, z_m[0]), (outer[0] + far, z_m[0])] + [
            (outer[1] + far, z_m[1]),
            (outer[1] + near, z_m[1]),
        ]

    def screen(self, z_m: Pair, surface: Finish, way: int = 1, margin_m: float = 0.08) -> Mesh:
        """Return a panel over the whole width of the front or rear, but for a margin."""
        low, high = self.half_m(z_m[0]), self.half_m(z_m[1])
        return prism(self._slab(z_m, way, 0.015, _DEPTH_M), 2 * (low - margin_m), surface, low - high)

    def badge(self, y_m: Pair, z_m: Pair, surface: Finish, way: int = 1, lift_m: float = 0.012) -> Mesh:
        """Return a panel on a piece of the front or rear."""
        outline = self._slab(z_m, way, lift_m, _DEPTH_M)
        return prism(outline, y_m[1] - y_m[0], surface).moved((0.0, (y_m[0] + y_m[1]) / 2, 0.0))

    def lamps(self, width_m: float, z_m: Pair, surface: Finish, way: int = 1, depth_m: float = 0.2) -> Mesh:
        """Lights at both corners of the front or rear, which go around them."""
        outline = self._slab(z_m, way, 0.02, depth_m)
        lamp = prism(outline, width_m, surface)
        y = self.half_m(z_m[0]) + 0.014 - width_m / 2
        return merge([lamp.moved((0.0, y, 0.0)), lamp.moved((0.0, -y, 0.0))])


def wheels(
    x_m: Sequence[float],
    side_m: float,
    radius_m: float,
    width_m: float = 0.22,
    hub: Finish = CHROME,
    hub_share: float = 0.62,
) -> Mesh:
    """Axles with a wheel at each end, the outer side of which is so far out."""
    parts = []
    for x in x_m:
        for way in (-1, 1):
            # Each piece goes a little further out and a little less far in than the one around it.
            for n, (radius, surface, sides) in enumerate(
                ((radius_m, RUBBER, 16), (radius_m * hub_share, hub, 10), (radius_m * 0.2, DARK, 6))
            ):
                inner, outer = side_m - width_m + n * LIFT_M, side_m + n * LIFT_M
                start, end = (x, way * inner, radius_m), (x, way * outer, radius_m)
                parts.append(tube(start, end, radius, surface, sides=sides))
    return merge(parts)


def arches(x_m: Sequence[float], side_m: float, radius_m: float, surface: Finish = DARK) -> Mesh:
    """Return the dark above the wheels, on both sides of a body whose side is so far out."""
    angle = np.linspace(0, np.pi, 9)
    rim = radius_m + 0.07
    outlines = [[(x + rim * float(np.cos(a)), radius_m + rim * float(np.sin(a))) for a in angle] for x in x_m]
    return merge(prism(outline, 2 * (side_m + LIFT_M), surface) for outline in outlines)


def ring(centre_m: Triple, radius_m: float, thick_m: float, surface: Finish, pieces: int = 14) -> Mesh:
    """Return an upright wheel rim or tyre that one can look through; its axle points left."""
    angle = np.arange(pieces) * 2 * np.pi / pieces
    # Corners of the cross-section, outwards and to the left, so that the faces look out.
    section = np.array([(1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0)]) * thick_m / 2
    reach = radius_m - thick_m / 2 + section[:, 0]
    corners = np.stack(
        [
            np.cos(angle)[:, None] * reach,
            np.repeat(section[None, :, 1], pieces, axis=0),
            np.sin(angle)[:, None] * reach,
        ],
        axis=-1,
    ).reshape(-1, 3) + np.array(centre_m)
    here, turn = (v.ravel() for v in np.meshgrid(np.arange(pieces), np.arange(4), indexing="ij"))
    after, beside = (here + 1) % pieces, (turn + 1) % 4
    a, b, c, d = here * 4 + turn, after * 4 + turn, after * 4 + beside, here * 4 + beside
    return of(corners, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]), surface)


def spokes(centre_m: Triple, radius_m: float, surface: Finish, count: int = 3) -> Mesh:
    """Thin bars across a wheel."""
    parts = []
    for angle in np.arange(count) * np.pi / count + 0.3:
        x, z = radius_m * float(np.cos(angle)), radius_m * float(np.sin(angle))
        cx, cy, cz = centre_m
        parts.append(tube((cx - x, cy, cz - z), (cx + x, cy, cz + z), 0.006, surface, sides=3))
    return merge(parts)
