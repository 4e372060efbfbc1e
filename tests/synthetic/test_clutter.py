"""Open land and growth beside the street: the setting `clutter` adds them, and nothing else changes."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.synthetic import clutter, thicket
from upvl_cli.synthetic.cast import Caster, Rays
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.synthetic.land import LAND_USES, Stretch, car_parks, open_land
from upvl_cli.synthetic.mesh import Mesh, merge
from upvl_cli.synthetic.motion import Motion
from upvl_cli.synthetic.piece import STUFF, Piece
from upvl_cli.synthetic.road import Road, road
from upvl_cli.synthetic.scene import CityScene
from upvl_cli.types import Floats

SHIPPED = CityConfig(**tomllib.loads((Path(__file__).parents[2] / "stages" / "synthetic.toml").read_text()))


@cache
def drive(amount: float) -> CityDrive:
    return City(replace(SHIPPED, frames=1, clutter=amount, sensor="beams16", density=0.3)).open("train-000")


def street(seed: int = 0) -> Road:
    return road(np.random.default_rng(seed))


def on(use: str, seed: int = 0) -> tuple[Road, Stretch, list[Piece]]:
    land = Stretch(1, 60.0, 90.0, use)
    return street(seed), land, clutter._on(street(seed), land, np.random.default_rng(seed))


def above_ground_m(of: Road, mesh: Mesh) -> tuple[Floats, Floats]:
    """|d| of the corners of a mesh, and how high they are above the ground there."""
    s, d = of.coordinates(mesh.corner_m[:, :2])
    return np.abs(d), mesh.corner_m[:, 2] - of.height(s, d)


def test_the_rest_of_the_city_stays_as_it_is() -> None:
    plain, more = (drive(amount).scene for amount in (0.0, 1.0))
    digests = {piece.mesh.corner_m.tobytes() for piece in more.pieces}
    gone = [piece.name for piece in plain.pieces if piece.mesh.corner_m.tobytes() not in digests]
    assert gone and set(gone) <= {"building", "house", "wall", "fence", "hedge", "tree"}
    assert len(more.pieces) > len(plain.pieces)
    kept = [thing.motion.place_m.tobytes() for thing in more.things]
    assert all(thing.motion.place_m.tobytes() in kept for thing in plain.things)
    assert {piece.name for piece in more.pieces} <= set(STUFF)


def test_a_seed_gives_the_same_bytes() -> None:
    again = City(replace(SHIPPED, frames=1, clutter=1.0, sensor="beams16", density=0.3)).open("train-000")
    assert again.points(0).xyz_ego_m.tobytes() == drive(1.0).points(0).xyz_ego_m.tobytes()
    assert drive(0.0).points(0).xyz_ego_m.tobytes() != drive(1.0).points(0).xyz_ego_m.tobytes()


def test_more_of_a_side_is_open_with_more_clutter() -> None:
    def share(amount: float) -> float:
        found = [open_land(street(seed), np.random.default_rng(seed), amount) for seed in range(8)]
        return sum(one.last_m - one.first_m for land in found for one in land) / (8 * 2 * 430)

    assert share(0.0) == 0
    assert 0.2 < share(0.5) < share(1.0) < 0.9
    uses = {one.use for seed in range(8) for one in open_land(street(seed), np.random.default_rng(seed), 1.0)}
    assert uses == set(LAND_USES)


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_added_on_the_roadways_or_where_people_walk(seed: int) -> None:
    rng = np.random.default_rng(seed)
    land = open_land(street(seed), rng, 1.0)
    for piece in clutter.clutter_pieces(street(seed), land, rng, 1.0):
        s, d = street(seed).coordinates(piece.mesh.corner_m[:, :2])
        away = np.abs(d) - street(seed).kerb_m
        assert away.min() > -0.2, piece.name
        assert not ((away > 1.35) & (away < 2.7)).any() or piece.name == "hedge", piece.name
        assert np.abs(s - street(seed).side_s_m).min() > 4.6, piece.name


@pytest.mark.parametrize("use", ["bank", "cut"])
def test_a_bank_rises_from_the_pavement_and_its_front_looks_up(use: str) -> None:
    for seed in range(4):
        of, _, pieces = on(use, seed)
        bank = next(piece.mesh for piece in pieces if piece.name == "grass")
        away, up = above_ground_m(of, bank)
        assert away.min() > of.front_m and up.max() > 0.4
        assert up[away > away.max() - 0.1].max() < 0
        a, b, c = (bank.corner_m[bank.face[:, corner]] for corner in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > -1e-6).mean() > 0.95
        assert any(piece.name == "wall" for piece in pieces) == (use == "cut")


def test_rays_pass_between_leaves_and_wires() -> None:
    rng = np.random.default_rng(3)
    bush = thicket.bush((2.0, 1.4, 1.4), rng, fine=True)
    net = merge([clutter._net(2.5, 1.5, clutter.STEEL, True)])
    z, y = (value.ravel() for value in np.meshgrid(np.linspace(0.2, 1.1, 40), np.linspace(-0.7, 0.7, 40)))
    start = np.stack([0 * y - 5, y, z], axis=1).astype(np.float32)
    shares = []
    for mesh, turned in ((bush, 0.0), (net, np.pi / 2)):
        scene = CityScene((), (Piece("hedge", mesh.moved((0.0, 0.0, 0.0), turned)),), Motion(*_still()))
        way = np.tile(np.float32([1, 0, 0]), (len(start), 1))
        met = Caster(scene).cast(Rays(start, way, np.zeros(len(start), np.int64), np.zeros(1)), reach_m=20.0)
        found = np.isfinite(met.range_m)
        shares.append(found.mean())
        if mesh is bush:  # ragged: neighbours are met at quite different ranges
            assert np.std(met.range_m[found]) > 0.1
    assert 0.4 < shares[0] < 0.98
    assert 0.05 < shares[1] < 0.4


def _still() -> tuple[Floats, Floats, Floats]:
    return np.zeros((1, 3)), np.zeros(1), np.zeros((1, 2))


def test_cars_of_a_car_park_stand_side_by_side_across_the_street() -> None:
    of = street()
    land = [Stretch(side, 60.0, 90.0, "car park") for side in (-1, 1)]
    found = car_parks(of, land, list(KINDS.values()), 1.0, np.random.default_rng(0))
    assert len(found) > 5
    for thing in found:
        s, d = of.coordinates(thing.motion.place_m[:, :2])
        length, width, _ = thing.model.size_lwh_m
        assert 60 < s[0] < 90 and np.abs(d[0]) - length / 2 > of.front_m + 1
        across = np.sin(thing.motion.heading_rad[0] - of.heading_rad(s)[0])
        assert abs(across) > 0.99 and not thing.motion.moves
