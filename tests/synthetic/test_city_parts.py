"""What the city is built from: forms, kinds, motions, traffic, and rays against a plain reference."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.synthetic.cast import Caster, Rays, swings
from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.synthetic.mesh import Mesh, box, ellipsoid, merge, prism, sheet, tube
from upvl_cli.synthetic.model import Part, model
from upvl_cli.synthetic.motion import Motion, rotations
from upvl_cli.synthetic.piece import STUFF, Piece
from upvl_cli.synthetic.road import Road, road
from upvl_cli.synthetic.scene import CityScene, Thing
from upvl_cli.synthetic.surface import BRICK, GLASS, STEEL
from upvl_cli.synthetic.surroundings import surroundings
from upvl_cli.synthetic.textures import TEXTURES, brightness
from upvl_cli.synthetic.traffic import Driver, follow
from upvl_cli.synthetic.way import along_street, turning_right
from upvl_cli.types import Floats

SEEDS = [np.random.SeedSequence(number) for number in range(3)]


def volume_m3(mesh: Mesh) -> float:
    a, b, c = (mesh.corner_m[mesh.face[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def street(seed: int = 0) -> Road:
    return road(np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box((4, 2, 1), (1, 2, 3), GLASS, yaw_rad=0.7), 8.0),
        (tube((0, 1, 0), (3, 0, 2), 1.0, GLASS, sides=200), np.pi * np.sqrt(14)),
        (tube((0, 0, 0), (0, 0, 3), 1.0, GLASS, end_radius_m=1e-9, sides=200), np.pi),
        (ellipsoid((2, 4, 6), (5, 5, 5), GLASS, sides=200), 4 / 3 * np.pi * 6),
        (prism([(-1, 0), (1, 0), (1, 1), (-1, 1)], 2, GLASS, inset_m=0.5), 3.0),
    ],
    ids=["box", "tube", "cone", "ellipsoid", "prism"],
)
def test_forms_have_their_volume_and_look_outwards(mesh: Mesh, volume: float) -> None:
    assert volume_m3(mesh) == pytest.approx(volume, rel=2e-3)


def test_merge_keeps_faces_and_surfaces() -> None:
    whole = merge([box((1, 1, 1), (0, 0, 0), GLASS), box((1, 1, 1), (3, 0, 0), BRICK)])
    assert volume_m3(whole) == pytest.approx(2)
    assert whole.surfaces == (GLASS, BRICK)
    assert np.bincount(whole.surface).tolist() == [len(whole.face) // 2] * 2


def test_a_sheet_looks_up() -> None:
    x, y = np.meshgrid([0.0, 1, 2], [0.0, 1], indexing="ij")
    flat = sheet(np.stack([x, y, np.zeros_like(x)], axis=-1), GLASS)
    a, b, c = (flat.corner_m[flat.face[:, corner]] for corner in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_stands_on_the_ground_in_its_box(name: str) -> None:
    for seed in SEEDS:
        one, again = (KINDS[name].build(np.random.default_rng(seed)) for _ in range(2))
        corners = np.concatenate([part.mesh.corner_m for part in one.parts])
        half = np.array(one.size_lwh_m) / 2 + 1e-9
        assert (np.abs(corners[:, :2]) <= half[:2]).all()
        assert corners[:, 2].min() >= 0 and corners[:, 2].max() <= one.size_lwh_m[2] + 1e-9
        assert sum(volume_m3(part.mesh) for part in one.parts) > 0
        assert one.size_lwh_m == again.size_lwh_m
        assert {surface.texture for part in one.parts for surface in part.mesh.surfaces} <= set(TEXTURES)
    assert len(KINDS[name].words) >= 3
    assert all(word == word.strip() and word for word in KINDS[name].words)


def test_there_are_enough_kinds_and_those_that_can_be_held_out() -> None:
    assert len(KINDS) >= 24
    assert {"fire truck", "tram", "crane", "wheelchair user"} <= set(KINDS)


def test_a_swinging_part_stays_in_its_box() -> None:
    leg = Part(tube((0, 0, 0), (0, 0, 1), 0.05, STEEL), 0.5, (0.0, 0.0, 1.0))
    found = model([leg, box((0.2, 0.2, 0.5), (0, 0, 1.3), STEEL)])
    assert found.size_lwh_m[0] > 2 * np.sin(0.5) * 0.9
    angles = swings(found.parts[1], np.linspace(0, 5, 50))
    assert np.abs(angles).max() == pytest.approx(0.5, rel=0.02)


def test_placed_goes_to_the_world_and_back() -> None:
    way = turning_right(street(), -5.0, 35.0, 7.0)
    placed = way.motion(np.linspace(20, 45, 60), 0.0).at(np.linspace(0, 2.9, 40))
    local = np.random.default_rng(0).normal(size=(40, 3))
    np.testing.assert_allclose(placed.local(placed.world(local)), local, atol=1e-9)
    np.testing.assert_allclose(
        placed.rotation @ placed.rotation.transpose(0, 2, 1), np.tile(np.eye(3), (40, 1, 1)), atol=1e-12
    )


def test_things_stand_upright_on_the_street() -> None:
    here = street(3)
    motion = along_street(here, -2.0, back=False).motion(np.linspace(0, 40, 80), 0.0)
    s, d = here.coordinates(motion.place_m[:, :2])
    np.testing.assert_allclose(motion.place_m[:, 2], here.height(s, d), atol=0.01)
    assert (rotations(motion.heading_rad, motion.slope)[:, 2, 2] > 0.99).all()


def test_coordinates_are_the_inverse_of_places() -> None:
    here = street(5)
    rng = np.random.default_rng(1)
    s, d = rng.uniform(-120, 200, 300), rng.uniform(-25, 25, 300)
    found_s, found_d = here.coordinates(here.place(s, d)[:, :2])
    np.testing.assert_allclose(found_s, s, atol=0.05)
    np.testing.assert_allclose(found_d, d, atol=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_drivers_keep_apart_and_wait_at_the_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way = along_street(street(), -2.0, back=False)
    lane = [
        Driver(
            way, 12.0 * place + rng.uniform(0, 3), rng.uniform(0, 12), rng.uniform(6, 14), rng.uniform(4, 7)
        )
        for place in range(8)
    ]
    along = follow(lane, 60.0, 400)
    length = np.array([driver.length_m for driver in lane])
    gap = along[1:] - along[:-1] - (length[1:] + length[:-1])[:, None] / 2
    assert gap.min() > 0
    assert (np.diff(along, axis=1) >= -1e-9).all()
    waiting = along[:, 0] + length / 2 < 45  # who was nearer could not have stopped
    assert (along[waiting, -1] + length[waiting] / 2 < 60.5).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_ground_is_where_the_street_says(seed: int) -> None:
    here = street(seed)
    pieces = surroundings(here, np.random.default_rng(seed))
    assert {piece.name for piece in pieces} <= set(STUFF)
    ground = [piece for piece in pieces if piece.name in ("road", "kerb", "pavement", "grass")]
    caster = Caster(CityScene((), ground, Motion(np.zeros((1, 3)), np.zeros(1), np.zeros((1, 2)))))
    rng = np.random.default_rng(7)
    s, d = rng.uniform(-100, 200, 3000), rng.uniform(-40, 40, 3000)
    above = here.place(s, d) + [0, 0, 5.0]
    rays = Rays(
        above.astype(np.float32), np.tile(np.float32([0, 0, -1]), (3000, 1)), np.zeros(3000, int), np.zeros(1)
    )
    off_m = np.abs(caster.cast(rays, reach_m=20.0).range_m - 5)
    assert np.quantile(off_m, 0.99) < 0.015
    assert off_m.max() < 0.14  # on the edge of a kerb


def slow_cast(meshes: list[Mesh], start: Floats, way: Floats) -> tuple[Floats, Floats]:
    """Distance and number of the mesh that each ray meets first: every ray against every triangle.

    Moeller and Trumbore, Fast, minimum storage ray-triangle intersection, 1997.
    """
    best, owner = np.full(len(way), np.inf), np.full(len(way), -1)
    for number, mesh in enumerate(meshes):
        a, b, c = (mesh.corner_m[mesh.face[:, corner]] for corner in range(3))
        for ray in range(len(way)):
            p = np.cross(way[ray], c - a)
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = 1 / np.einsum("ij,ij->i", b - a, p)
                u = np.einsum("ij,ij->i", start[ray] - a, p) * scale
                q = np.cross(start[ray] - a, b - a)
                v = q @ way[ray] * scale
                t = np.einsum("ij,ij->i", c - a, q) * scale
            t = t[(u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)]
            if len(t) and t.min() < best[ray]:
                best[ray], owner[ray] = t.min(), number
    return best, owner


def test_rays_meet_what_a_plain_search_finds() -> None:
    rng = np.random.default_rng(2)
    time_s, things, meshes = 0.35, [], []
    for number, name in enumerate(("sedan", "adult", "bench", "cyclist", "dog")):
        built = KINDS[name].build(rng)
        steps = np.linspace(0, 1, 21)[:, None] * [1.5, 0.2 * number, 0.0]
        place = np.array([6 + 2.0 * number, 3.0 * number - 6, 0.0]) + (
            steps if name != "bench" else steps[:1]
        )
        heading = np.full(len(place), 0.3 * number)
        motion = Motion(place, heading, np.zeros((len(place), 2)))
        things.append(Thing(KINDS[name], built, motion))
        placed = motion.at(np.array([time_s]))
        swung = [
            part.mesh.tilted(float(swings(part, placed.odometer_m)[0]), part.pivot_m) for part in built.parts
        ]
        whole = merge(swung)
        meshes.append(Mesh(placed.world(whole.corner_m), whole.face, whole.surface, whole.surfaces))
    wall = box((0.3, 30, 4), (22, 0, 2), BRICK)
    ego = Motion(np.zeros((1, 3)), np.zeros(1), np.zeros((1, 2)))
    caster = Caster(CityScene(tuple(things), (Piece("wall", wall),), ego))
    azimuth, height = rng.uniform(-0.7, 0.7, 400), rng.uniform(-0.25, 0.1, 400)
    way = np.column_stack([np.cos(azimuth), np.sin(azimuth), height])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    start = np.tile([0.0, 0.0, 1.6], (400, 1))
    rays = Rays(start.astype(np.float32), way.astype(np.float32), np.zeros(400, int), np.array([time_s]))
    hits = caster.cast(rays, reach_m=80.0)
    slow_m, owner = slow_cast([*meshes, wall], start, way)
    thing = np.where(owner == len(meshes), -1, owner)
    same = np.isclose(hits.range_m, slow_m, atol=2e-3) | (np.isinf(hits.range_m) & np.isinf(slow_m))
    assert same.mean() > 0.99  # a ray along an edge may go either way
    assert (hits.thing[same] == thing[same]).all()
    assert len(set(thing)) > 4
    dark = caster.shaded(rays, reach_m=80.0)
    assert (dark == np.isfinite(slow_m)).mean() > 0.99


@pytest.mark.parametrize("texture", TEXTURES)
def test_textures_are_always_the_same_and_neither_black_nor_glaring(texture: str) -> None:
    rng = np.random.default_rng(0)
    place, normal = rng.uniform(-100, 100, (5000, 3)), rng.normal(size=(5000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    first, second = (brightness(texture, place, normal) for _ in range(2))
    assert (first == second).all()
    assert first.min() > 0.3 and first.max() < 1.6 and 0.7 < first.mean() < 1.15
