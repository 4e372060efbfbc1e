"""Casts rays at the city: the first surface on each ray, at the time of that ray.

Embree finds the triangles (Wald et al., "Embree: a kernel framework for efficient CPU ray tracing",
SIGGRAPH 2014). What stands for good is one mesh in world axes. Each thing has meshes in its own axes:
rays are brought there by where it is at the time of each ray, so a sweep sees it move.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from upvl_cli.datasets.city.mesh import Mesh, Triple, joined
from upvl_cli.datasets.city.model import STRIDE_HZ_PER_MPS, Part
from upvl_cli.datasets.city.motion import Placed
from upvl_cli.datasets.city.scene import STUFF_NAMES, Scene
from upvl_cli.types import Array, Bools, Floats, Ints, ParallelArrays, array

NOTHING = -1
_BLOCK = 1024  # rays that are looked at together first
_CLEAR_M = 1e-3  # a shadow ray starts this far off its surface


class Rays(NamedTuple):
    """Rays in world axes, in Embree's precision; those that follow each other are best close together.

    Attributes:
        start_m: (n, 3) float32, where each starts.
        way: (n, 3) float32 directions, of length 1.
        time_s: (n,) when.
    """

    start_m: Floats
    way: Floats
    time_s: Floats

    def chosen(self, index: Array) -> Rays:
        """Those of that mask or those numbers."""
        return Rays(self.start_m[index], self.way[index], self.time_s[index])


@dataclass(frozen=True)
class Hits(ParallelArrays):
    """What each ray meets first.

    Attributes:
        range_m: (n,) distance along the ray; infinite where it meets nothing.
        normal: (n, 3) to the side of the surface that the ray comes from, in world axes.
        local_m: (n, 3) the place in the axes of the thing, its swinging parts at rest; in world axes on stuff.
        surface: (n,) place in the scene's `surfaces`; -1 for nothing.
        name: (n,) place in the scene's `names`; -1 for nothing.
        thing: (n,) number of the thing; -1 for stuff and nothing.
        part: (n,) which part of the thing.
    """

    range_m: Array = array("float32")
    normal: Array = array("float32", 3)
    local_m: Array = array("float32", 3)
    surface: Array = array("int32")
    name: Array = array("int32")
    thing: Array = array("int32")
    part: Array = array("int32")


class _Triangles(NamedTuple):
    """A mesh that can be asked, and what each of its faces is."""

    scene: EmbreeScene
    surface: Ints
    name: Ints


class Caster:
    """Asks one scene; its meshes are built once."""

    def __init__(self, scene: Scene) -> None:
        """Build the meshes."""
        self.scene = scene
        number = {surface: place for place, surface in enumerate(scene.surfaces)}

        def triangles(mesh: Mesh, name: Ints) -> _Triangles:
            surface = np.array([number[one] for one in mesh.surfaces], dtype=np.int64)[mesh.surface]
            found = EmbreeScene()
            TriangleMesh(found, mesh.corner_m.astype(np.float32), mesh.face.astype(np.int32))
            return _Triangles(found, surface, name)

        stuff = np.concatenate(
            [
                np.zeros(0, np.int64),
                *(np.full(len(p.mesh.face), STUFF_NAMES.index(p.name)) for p in scene.pieces),
            ]
        )
        self._stuff = triangles(joined(piece.mesh for piece in scene.pieces), stuff)
        self._parts = [
            [triangles(part.mesh, np.full(len(part.mesh.face), name)) for part in thing.model.parts]
            for thing, name in zip(scene.things, scene.name_of_thing, strict=True)
        ]

    def cast(self, rays: Rays, *, reach_m: float) -> tuple[Hits, Ints]:
        """The first surface on each ray, and on how many rays each thing would be seen if it were alone.

        Args:
            rays: The rays.
            reach_m: A surface further away is not met.

        Returns:
            The hits, and (t,) counts.
        """
        total = len(rays.way)
        surface, name, thing, part = (np.full(total, NOTHING, dtype=np.int32) for _ in range(4))
        alone = np.zeros(len(self.scene.things), dtype=np.int64)
        met, found = _ask(self._stuff, rays.start_m, rays.way, reach_m)
        best_m, normal = np.where(met, found["tfar"], np.float32(np.inf)), found["Ng"]
        local = rays.start_m + np.where(met, best_m, np.float32(0))[:, None] * rays.way
        surface[met] = self._stuff.surface[found["primID"][met]]
        name[met] = self._stuff.name[found["primID"][met]]
        for number, near in self._near(rays, reach_m):
            placed = self.scene.things[number].motion.at(rays.time_s[near])
            start, way = placed.local(rays.start_m[near]), placed.inward(rays.way[near])
            any_part = np.zeros(len(near), dtype=np.bool_)
            for place, rigid in enumerate(self.scene.things[number].model.parts):
                turn = swings(rigid, placed.odometer_m)
                start_here, way_here = _turned(start, -turn, rigid.pivot_m), _turned(way, -turn)
                met, found = _ask(self._parts[number][place], start_here, way_here, reach_m)
                any_part |= met
                met &= found["tfar"] < best_m[near]
                at = near[met]
                best_m[at] = found["tfar"][met]
                local[at] = start_here[met] + best_m[at, None] * way_here[met]
                outward = _turned(found["Ng"][met], turn if len(turn) == 1 else turn[met])
                normal[at] = placed.chosen(met).outward(outward)
                surface[at] = self._parts[number][place].surface[found["primID"][met]]
                name[at], thing[at], part[at] = self.scene.name_of_thing[number], number, place
            alone[number] = any_part.sum()
        length = np.sqrt(np.einsum("ni,ni->n", normal, normal))
        towards = -np.sign(np.einsum("ni,ni->n", normal, rays.way))
        normal *= (towards / np.where(length > 0, length, 1))[:, None]
        return Hits(best_m, normal, local, surface, name, thing, part), alone

    def shaded(self, rays: Rays, *, reach_m: float) -> Bools:
        """(n,) whether anything lies on each ray: what a light at its end does not reach."""
        start_m = rays.start_m + np.float32(_CLEAR_M) * rays.way
        dark = _asked(self._stuff.scene, start_m, rays.way, reach_m, "OCCLUDED") >= 0
        for number, around in self._near(rays, reach_m):
            near = around[~dark[around]]
            placed = self.scene.things[number].motion.at(rays.time_s[near])
            start, way = placed.local(start_m[near]), placed.inward(rays.way[near])
            for place, rigid in enumerate(self.scene.things[number].model.parts):
                turn = swings(rigid, placed.odometer_m)
                start_here, way_here = _turned(start, -turn, rigid.pivot_m), _turned(way, -turn)
                hidden = (
                    _asked(self._parts[number][place].scene, start_here, way_here, reach_m, "OCCLUDED") >= 0
                )
                dark[near[hidden]] = True
        return np.asarray(dark)

    def _near(self, rays: Rays, reach_m: float) -> Iterator[tuple[int, Ints]]:
        """Each thing with the rays that pass its ball."""
        total = len(rays.way)
        if not total:
            return
        first, block_of = np.arange(0, total, _BLOCK), np.arange(total) // _BLOCK
        axis = np.add.reduceat(rays.way, first).astype(np.float64)
        axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-9)[:, None]
        slant = np.einsum("ni,ni->n", rays.way, axis.astype(np.float32)[block_of])
        spread = np.arccos(np.clip(np.minimum.reduceat(slant, first), -1, 1)) + 1e-3
        low, high = np.minimum.reduceat(rays.start_m, first), np.maximum.reduceat(rays.start_m, first)
        middle, wide = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
        centre, radius = self._balls(float(rays.time_s.min()), float(rays.time_s.max()))
        # Whole blocks first: the cone of a block's ways, from the middle of its starts, against each ball.
        away = centre[:, None] - middle
        distance = np.maximum(np.linalg.norm(away, axis=2), 1e-9)
        angle = np.arccos(np.clip(np.einsum("tbi,bi->tb", away, axis) / distance, -1, 1))
        size = radius[:, None] + wide
        seen = spread + np.arcsin(np.clip(size / distance, 0, 1))
        met = (distance < reach_m + size) & ((angle < seen) | (distance < size))
        for number in np.flatnonzero(met.any(axis=1)):
            here = np.flatnonzero(met[number][block_of])
            x, y, z = (centre[number].astype(np.float32) - rays.start_m[here]).T
            i, j, k = rays.way[here].T
            along = x * i + y * j + z * k
            near = here[
                (x * x + y * y + z * z - along * along < radius[number] ** 2) & (along > -radius[number])
            ]
            if len(near):
                yield int(number), near

    def _balls(self, from_s: float, until_s: float) -> tuple[Floats, Floats]:
        """(t, 3) centres and (t,) radii of balls around the things, wherever they are in that time."""
        motions = [thing.motion for thing in self.scene.things]
        first, last = (np.array([m.place_at(t) for m in motions]).reshape(-1, 3) for t in (from_s, until_s))
        size = np.array([thing.model.size_lwh_m for thing in self.scene.things]).reshape(-1, 3)
        centre = (first + last) / 2 + size * [0, 0, 0.5]
        return centre, np.linalg.norm(size, axis=1) / 2 + np.linalg.norm(last - first, axis=1) / 2 + 0.3


def swings(part: Part, odometer_m: Array) -> Floats:
    """(n,) how far a part has swung to the front when its thing has gone that far."""
    if not part.swing_rad:
        return np.zeros(len(odometer_m))
    return np.asarray(part.swing_rad * np.sin(2 * np.pi * STRIDE_HZ_PER_MPS * odometer_m + part.phase_rad))


def world_places(scene: Scene, hits: Hits, placed_s: Array) -> Floats:
    """(n, 3) where the places that were met are at other times: fixed to their thing and its part.

    Args:
        scene: The scene.
        hits: What was met.
        placed_s: (n,) the times.
    """
    out = np.array(hits.local_m, dtype=np.float64)
    for number in np.unique(hits.thing[hits.thing >= 0]):
        of = np.flatnonzero(hits.thing == number)
        placed: Placed = scene.things[number].motion.at(placed_s[of])
        local = out[of]
        for place in np.unique(hits.part[of]):
            part, mine = scene.things[number].model.parts[place], hits.part[of] == place
            turn = swings(part, placed.chosen(mine).odometer_m)
            local[mine] = _turned(local[mine], turn, part.pivot_m)
        out[of] = placed.world(local)
    return out


def _turned(xyz: Array, pitch_rad: Array, pivot_m: Triple = (0.0, 0.0, 0.0)) -> Floats:
    """(n, 3) places turned about the axis to the left through the pivot; positive lowers the front.

    Args:
        xyz: (n, 3) places, or directions.
        pitch_rad: (n,) or (1,) angles.
        pivot_m: The place that stays.
    """
    if not np.any(pitch_rad):
        return np.asarray(xyz)
    cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
    pivot = np.asarray(pivot_m, dtype=xyz.dtype)
    x, y, z = (np.asarray(xyz) - pivot).T
    return np.asarray(np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=1) + pivot, dtype=xyz.dtype)


def _ask(
    triangles: _Triangles, start_m: Floats, way: Floats, reach_m: float
) -> tuple[Bools, dict[str, Array]]:
    found = _asked(triangles.scene, start_m, way, reach_m, "INTERSECT")
    return found["primID"] >= 0, found


def _asked(scene: EmbreeScene, start_m: Floats, way: Floats, reach_m: float, query: str) -> Array:
    return scene.run(
        np.ascontiguousarray(start_m, np.float32),
        np.ascontiguousarray(way, np.float32),
        dists=np.full(len(way), reach_m, np.float32),
        query=query,
        output=1 if query == "INTERSECT" else None,
    )
