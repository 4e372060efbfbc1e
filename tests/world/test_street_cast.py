"""Rays meet what a plain walk along them meets."""

from __future__ import annotations

import numpy as np
import pytest

from world.cast import cast
from world.scene import BOX, CYLINDER, ELLIPSOID, MATERIAL_NUMBER, Ground, Solids

LOW = Ground(y_m=(-1e3, 1e3), z_m=(-50.0, -50.0), materials=("asphalt",), grade=0.0)
STEP_M = 0.004


def solid(form, centre_m, size_lwh_m, heading_rad=0.0):
    half_m = np.array([size_lwh_m]) / 2
    return Solids([form], [centre_m], half_m, [heading_rad], [MATERIAL_NUMBER["red"]], [0])


def join(*solids):
    parts = {
        name: np.concatenate([getattr(s, name) for s in solids]) for name in ("form", "centre_m", "half_m")
    }
    rest = {name: np.concatenate([getattr(s, name) for s in solids]) for name in ("heading_rad", "material")}
    return Solids(**parts, **rest, thing=np.arange(len(solids)))


def inside(xyz_m, solids, i):
    """Tell whether points lie in solid i, by the definition of its form."""
    x, y, z = (xyz_m - solids.centre_m[i]).T
    cos, sin = np.cos(solids.heading_rad[i]), np.sin(solids.heading_rad[i])
    a, b, c = np.array([cos * x + sin * y, cos * y - sin * x, z]) / solids.half_m[i][:, None]
    if solids.form[i] == BOX:
        return np.maximum(np.maximum(abs(a), abs(b)), abs(c)) <= 1
    if solids.form[i] == CYLINDER:
        return (a**2 + b**2 <= 1) & (abs(c) <= 1)
    return a**2 + b**2 + c**2 <= 1


def marched(origin_m, ray, solids, reach_m):
    """Walk along a ray in small steps until a solid holds the place: the plain reference."""
    steps_m = np.arange(0, reach_m, STEP_M)
    places_m = origin_m + steps_m[:, None] * ray
    first = [np.flatnonzero(inside(places_m, solids, i))[:1] for i in range(len(solids))]
    found = [(int(at[0]), i) for i, at in enumerate(first) if len(at)]
    return (min(found)[0] * STEP_M, min(found)[1]) if found else (np.inf, -1)


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_solid_is_the_one_that_small_steps_meet(seed):
    rng = np.random.default_rng(seed)
    solids = join(
        *(
            solid(form, rng.uniform(-6, 6, 3) + [9, 0, 0], rng.uniform(0.4, 5, 3), rng.uniform(-4, 4))
            for form in (BOX, CYLINDER, ELLIPSOID, BOX, CYLINDER, ELLIPSOID)
        )
    )
    origin_m = np.zeros(3)
    outside = not any(inside(origin_m[None], solids, i)[0] for i in range(len(solids)))
    assert outside
    rays = rng.normal(size=(60, 3)) * [0.3, 0.5, 0.5] + [1, 0, 0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = cast(origin_m, rays, solids, LOW, reach_m=20.0)
    slow = [marched(origin_m, ray, solids, 20.0) for ray in rays]
    same = [
        hit.solid[0] == number
        for hit, (_, number) in zip((hits[i : i + 1] for i in range(60)), slow, strict=True)
    ]
    assert np.mean(same) > 0.96  # steps miss a corner that is thinner than they are long
    for got_m, (expected_m, number), agrees in zip(hits.range_m, slow, same, strict=True):
        if agrees and number >= 0:
            assert -STEP_M < got_m - expected_m <= 1e-9
    assert len(set(hits.solid)) > 3


@pytest.mark.parametrize(
    ("form", "ray", "range_m", "normal"),
    [
        pytest.param(BOX, (1, 0, 0), 9.0, (-1, 0, 0), id="near face of a box"),
        pytest.param(CYLINDER, (1, 0, 0), 9.0, (-1, 0, 0), id="round side of a cylinder"),
        pytest.param(ELLIPSOID, (1, 0, 0), 9.0, (-1, 0, 0), id="near end of an ellipsoid"),
        pytest.param(BOX, (0, 1, 0), np.inf, (0, 0, 0), id="beside it"),
        pytest.param(BOX, (-1, 0, 0), np.inf, (0, 0, 0), id="behind the start"),
    ],
)
def test_one_ray_at_a_solid_of_length_two(form, ray, range_m, normal):
    hits = cast(
        np.zeros(3), np.array([ray], dtype=float), solid(form, (10, 0, 0), (2, 2, 2)), LOW, reach_m=40.0
    )
    assert hits.range_m[0] == pytest.approx(range_m)
    np.testing.assert_allclose(hits.normal, [normal], atol=1e-12)


def test_a_ray_from_above_meets_the_roof():
    for form in (BOX, CYLINDER):
        hits = cast(
            np.array([0, 0, 5.0]),
            np.array([[0, 0, -1.0]]),
            solid(form, (0.2, 0.1, 1), (2, 2, 2)),
            LOW,
            reach_m=9.0,
        )
        assert hits.range_m[0] == pytest.approx(3.0)
        np.testing.assert_allclose(hits.normal, [[0, 0, 1]], atol=1e-12)


def test_normals_have_length_one_and_look_back():
    rng = np.random.default_rng(3)
    solids = join(
        *(solid(form, (8, 3 * form - 3, 0), (2, 1.5, 3), 0.4 + form) for form in (BOX, CYLINDER, ELLIPSOID))
    )
    rays = rng.normal(size=(500, 3)) * [0.05, 0.4, 0.2] + [1, 0, 0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = cast(np.zeros(3), rays, solids, LOW, reach_m=40.0)
    met = hits[hits.solid >= 0]
    assert set(met.solid) == {0, 1, 2}
    np.testing.assert_allclose(np.linalg.norm(met.normal, axis=1), 1.0)
    assert ((met.normal * rays[hits.solid >= 0]).sum(axis=1) < 0).all()


def test_a_box_behind_a_wall_is_not_met():
    wall, box = solid(BOX, (10, 0, 0), (0.2, 30, 20)), solid(BOX, (15, 0, 0), (2, 2, 2), 0.3)
    spread = np.linspace(-0.3, 0.3, 21)
    rays = np.array([(1, y, z) for y in spread for z in spread])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    assert (cast(np.zeros(3), rays, box, LOW, reach_m=40.0).solid == 0).sum() > 10
    assert (cast(np.zeros(3), rays, join(wall, box), LOW, reach_m=40.0).solid == 0).all()
    assert (cast(np.zeros(3), rays, join(box, wall), LOW, reach_m=40.0).solid == 1).all()


def test_the_ground_ends_each_ray_at_its_own_strip():
    kerb = Ground(
        y_m=(-9, 0, 0.1, 9), z_m=(0, 0, 0.1, 0.1), materials=("asphalt", "kerb", "pavement"), grade=0.02
    )
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(400, 3)) * [1, 0.5, 0.1] - [0, 0, 0.5]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    origin_m = np.array([0, -0.4, 1.5])
    none = solid(BOX, (0, 0, 0), (1, 1, 1))[:0]
    hits = cast(origin_m, rays, none, kerb, reach_m=30.0)
    at_m = (origin_m + rays * hits.range_m[:, None])[np.isfinite(hits.range_m)]
    np.testing.assert_allclose(at_m[:, 2], kerb.height_m(at_m[:, 0], at_m[:, 1]), atol=1e-9)
    expected = np.array([MATERIAL_NUMBER[name] for name in kerb.materials])[
        np.searchsorted([0, 0.1], at_m[:, 1])
    ]
    np.testing.assert_array_equal(hits.material[np.isfinite(hits.range_m)], expected)
    assert len(at_m) > 300 and len(set(expected)) == 3


def test_no_rays_meet_nothing():
    assert len(cast(np.zeros(3), np.zeros((0, 3)), solid(BOX, (9, 0, 0), (1, 1, 1)), LOW, reach_m=9.0)) == 0


def test_what_is_out_of_reach_is_not_met():
    ray = np.array([[1.0, 0.0, 0.0]])
    assert cast(np.zeros(3), ray, solid(BOX, (10, 0, 0), (2, 2, 2)), LOW, reach_m=8.9).range_m[0] == np.inf
    assert cast(np.zeros(3), ray, solid(BOX, (10, 0, 0), (2, 2, 2)), LOW, reach_m=9.1).solid[0] == 0
