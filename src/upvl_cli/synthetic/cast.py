"""Casts rays at the city: the first surface on each ray, at the time of that ray.

Embree finds the triangles (Wald et al., "Embree: a kernel framework for efficient CPU ray tracing",
SIGGRAPH 2014). What never moves is one mesh in world axes. What moves has meshes in its own axes: rays are
brought there by where it is at the time of each ray, so a sweep sees it move.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene

from upvl_cli.synthetic.mesh import Mesh, Triple, joined
from upvl_cli.synthetic.model import STRIDE_HZ_PER_MPS, Part
from upvl_cli.synthetic.motion import Placed
from upvl_cli.synthetic.scene import STUFF_NAMES, CityScene
from upvl_cli.types import Array, Bools, Floats, Ints, ParallelArrays, array

NOTHING = -1
_BLOCK = 256  # rays that are looked at together first
_CLEAR_M = 1e-3  # a shadow ray starts this far off its surface
# One for all meshes: with one each, a process that made many cities ran out of them and fell.
_DEVICE = EmbreeDevice()


class Rays(NamedTuple):
    """Rays in world axes, in Embree's precision; those that follow each other are best close together.

    Attributes:
        start_m: (n, 3) float32, where each starts.
        way: (n, 3) float32 directions, of length 1.
        moment: (n,) place in `moments_s` of the time of each ray.
        moments_s: (m,) the times, ascending.
    """

    start_m: Array
    way: Array
    moment: Ints
    moments_s: Floats

    def chosen(self, index: Array) -> Rays:
        """Those of that mask or those numbers."""
        return self._replace(start_m=self.start_m[index], way=self.way[index], moment=self.moment[index])


@dataclass(frozen=True)
class RayHits(ParallelArrays):
    """What each ray meets first.

    Attributes:
        range_m: (n,) distance along the ray; infinite where it meets nothing.
        normal: (n, 3) to the side of the surface that the ray comes from, in world axes.
        local_m: (n, 3) the place in the axes of what moves, its parts at rest; in world axes on what never does.
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
    """A mesh that can be asked, and what each of its faces is, as in `RayHits`; the last entry is for no face."""

    scene: EmbreeScene
    surface: Ints
    name: Ints
    thing: Ints
    part: Ints


class Caster:
    """Asks one scene; its meshes are built once. What never moves is one mesh, things and stuff together."""

    def __init__(self, scene: CityScene) -> None:
        """Build the meshes."""
        self.scene = scene
        number = {surface: place for place, surface in enumerate(scene.surfaces)}

        def triangles(owned: Sequence[tuple[Mesh, int, int, int]]) -> _Triangles:
            """Meshes with the name, thing and part of each, as one."""
            mesh = joined(mesh for mesh, *_ in owned)
            surface = np.array([number[one] for one in mesh.surfaces], dtype=np.int32)[mesh.surface]
            faces = np.array([len(mesh.face) for mesh, *_ in owned], dtype=np.int64)
            name, thing, part = np.array([owner for _, *owner in owned], dtype=np.int32).reshape(-1, 3).T
            found = EmbreeScene(_DEVICE)
            TriangleMesh(found, mesh.corner_m.astype(np.float32), mesh.face.astype(np.int32))
            of_face = (surface, *(np.repeat(of, faces) for of in (name, thing, part)))
            return _Triangles(found, *(np.append(of, np.int32(NOTHING)) for of in of_face))

        still = [(piece.mesh, STUFF_NAMES.index(piece.name), NOTHING, NOTHING) for piece in scene.pieces]
        self._movers: dict[int, list[_Triangles]] = {}
        for place, (thing, name) in enumerate(zip(scene.things, scene.name_of_thing.tolist(), strict=True)):
            owned = [(part.mesh, name, place, at) for at, part in enumerate(thing.model.parts)]
            if thing.motion.moves:
                self._movers[place] = [triangles([one]) for one in owned]
            else:
                placed = thing.motion.at(np.zeros(1))
                still += [
                    (replace(mesh, corner_m=placed.world(mesh.corner_m)), *owner) for mesh, *owner in owned
                ]
        self._still = triangles(still)

    def cast(self, rays: Rays, *, reach_m: float) -> RayHits:
        """Return the first surface on each ray.

        Args:
            rays: The rays.
            reach_m: A surface further away is not met.
        """
        met, found = _ask(self._still, rays, reach_m)
        range_m, normal = np.where(met, found["tfar"], np.float32(np.inf)), found["Ng"]
        local = rays.start_m + np.where(met, range_m, np.float32(0))[:, None] * rays.way
        surface, name, thing, part = (of[found["primID"]] for of in self._still[1:])
        for number, near in self._near(rays, reach_m):
            for triangles, placed, turn, here in self._brought(number, rays.chosen(near)):
                met, found = _ask(triangles, here, reach_m)
                met &= found["tfar"] < range_m[near]
                at, face = near[met], found["primID"][met]
                range_m[at] = found["tfar"][met]
                local[at] = here.start_m[met] + range_m[at, None] * here.way[met]
                outward = _turned(found["Ng"][met], turn if len(turn) == 1 else turn[met])
                normal[at] = placed.chosen(met).outward(outward)
                for values, of in zip((surface, name, thing, part), triangles[1:], strict=True):
                    values[at] = of[face]
        length = np.sqrt(np.einsum("ni,ni->n", normal, normal))
        towards = -np.sign(np.einsum("ni,ni->n", normal, rays.way))
        normal *= (towards / np.where(length > 0, length, 1))[:, None]
        return RayHits(range_m, normal, local, surface, name, thing, part)

    def shaded(self, rays: Rays, *, reach_m: float) -> Bools:
        """(n,) whether anything lies on each ray: what a light at its end does not reach."""
        rays = rays._replace(start_m=rays.start_m + np.float32(_CLEAR_M) * rays.way)
        dark = _asked(self._still.scene, rays, reach_m, "OCCLUDED") >= 0
        for number, around in self._near(rays, reach_m):
            near = around[~dark[around]]
            for triangles, _, _, here in self._brought(number, rays.chosen(near)):
                dark[near[_asked(triangles.scene, here, reach_m, "OCCLUDED") >= 0]] = True
        return np.asarray(dark)

    def alone(self, rays: Rays, *, reach_m: float) -> Ints:
        """(t,) on how many rays each thing would be if there were nothing else.

        Args:
            rays: The rays.
            reach_m: What is further away is not counted.
        """
        counts = np.zeros(len(self.scene.things), dtype=np.int64)
        for number, thing in enumerate(self.scene.things):
            only = Caster(CityScene((thing,), (), self.scene.ego))
            counts[number] = (only.cast(rays, reach_m=reach_m).thing == 0).sum()
        return counts

    def _brought(self, number: int, rays: Rays) -> Iterator[tuple[_Triangles, Placed, Floats, Rays]]:
        """Each part of a mover: its mesh, where the mover is, how far the part has swung, the rays in its axes."""
        thing = self.scene.things[number]
        first, last = (int(rays.moment.min()), int(rays.moment.max())) if len(rays.moment) else (0, 0)
        placed = thing.motion.at(rays.moments_s[first : last + 1]).chosen(rays.moment - first)
        start, way = placed.local(rays.start_m), placed.inward(rays.way)
        for triangles, part in zip(self._movers[number], thing.model.parts, strict=True):
            turn = swings(part, placed.odometer_m)
            here = Rays(_turned(start, -turn, part.pivot_m), _turned(way, -turn), rays.moment, rays.moments_s)
            yield triangles, placed, turn, here

    def _near(self, rays: Rays, reach_m: float) -> Iterator[tuple[int, Ints]]:
        """Each mover with the rays that come near it, in whole blocks: Embree is quicker than a closer look."""
        total = len(rays.way)
        if not total or not self._movers:
            return
        first, block_of = np.arange(0, total, _BLOCK), np.arange(total) // _BLOCK
        axis = np.add.reduceat(rays.way, first).astype(np.float64)
        axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-9)[:, None]
        slant = np.einsum("ni,ni->n", rays.way, axis.astype(np.float32)[block_of])
        spread = np.arccos(np.clip(np.minimum.reduceat(slant, first), -1, 1)) + 1e-3
        low, high = np.minimum.reduceat(rays.start_m, first), np.maximum.reduceat(rays.start_m, first)
        middle, wide = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
        movers = list(self._movers)
        centre, radius = self._balls(movers, float(rays.moments_s[0]), float(rays.moments_s[-1]))
        # The cone of a block's ways, from the middle of its starts, against each ball.
        away = centre[:, None] - middle
        distance = np.maximum(np.linalg.norm(away, axis=2), 1e-9)
        angle = np.arccos(np.clip(np.einsum("tbi,bi->tb", away, axis) / distance, -1, 1))
        size = radius[:, None] + wide
        seen = spread + np.arcsin(np.clip(size / distance, 0, 1))
        met = (distance < reach_m + size) & ((angle < seen) | (distance < size))
        for row in np.flatnonzero(met.any(axis=1)):
            near = (np.flatnonzero(met[row])[:, None] * _BLOCK + np.arange(_BLOCK)).ravel()
            yield movers[row], near[near < total]

    def _balls(self, movers: Sequence[int], from_s: float, until_s: float) -> tuple[Floats, Floats]:
        """(m, 3) centres and (m,) radii of balls around the movers, wherever they are in that time."""
        things = [self.scene.things[number] for number in movers]
        motions = [thing.motion for thing in things]
        first, last = (np.array([m.place_at(t) for m in motions]).reshape(-1, 3) for t in (from_s, until_s))
        size = np.array([thing.model.size_lwh_m for thing in things]).reshape(-1, 3)
        centre = (first + last) / 2 + size * [0, 0, 0.5]
        return centre, np.linalg.norm(size, axis=1) / 2 + np.linalg.norm(last - first, axis=1) / 2 + 0.3


def swings(part: Part, odometer_m: Array) -> Floats:
    """(n,) how far a part has swung to the front when its thing has gone that far."""
    if not part.swing_rad:
        return np.zeros(len(odometer_m))
    return np.asarray(part.swing_rad * np.sin(2 * np.pi * STRIDE_HZ_PER_MPS * odometer_m + part.phase_rad))


def world_places(scene: CityScene, hits: RayHits, placed_s: Array) -> Floats:
    """(n, 3) where the places that were met on movers are at other times: fixed to their thing and its part.

    Args:
        scene: The scene.
        hits: What was met.
        placed_s: (n,) the times.
    """
    out = np.array(hits.local_m, dtype=np.float64)
    for number in np.unique(hits.thing[hits.thing >= 0]).tolist():
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


def _ask(triangles: _Triangles, rays: Rays, reach_m: float) -> tuple[Bools, Any]:
    found = _asked(triangles.scene, rays, reach_m, "INTERSECT")
    return found["primID"] >= 0, found


def _asked(scene: EmbreeScene, rays: Rays, reach_m: float, query: str) -> Any:
    return scene.run(
        np.ascontiguousarray(rays.start_m, np.float32),
        np.ascontiguousarray(rays.way, np.float32),
        dists=np.full(len(rays.way), reach_m, np.float32),
        query=query,
        output=1 if query == "INTERSECT" else None,
    )
