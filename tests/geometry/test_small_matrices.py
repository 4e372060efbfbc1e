"""Products and solutions of small matrices are those of numpy, in an order of summation of their own."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.se3 import compose, from_yaw, rotate
from upvl_cli.geometry.small_matrices import product, solve_positive_definite, transposed

RNG = np.random.default_rng(0)


def test_products_are_those_of_numpy() -> None:
    for a, b in (((2, 3), (3, 4)), ((7, 4, 4), (7, 4, 1)), ((5, 1, 4, 4), (6, 4, 2))):
        first, second = RNG.normal(size=a), RNG.normal(size=b)
        np.testing.assert_allclose(product(first, second), first @ second, atol=1e-14)


def test_sums_run_in_the_order_of_the_index_without_fused_steps() -> None:
    a, b = RNG.normal(size=(4, 4)), RNG.normal(size=(4, 4))
    by_hand = [[((a[i, 0] * b[0, j] + a[i, 1] * b[1, j]) + a[i, 2] * b[2, j]) + a[i, 3] * b[3, j]
                for j in range(4)] for i in range(4)]  # fmt: skip
    assert product(a, b).tolist() == by_hand
    assert product(np.stack([a] * 9), b)[3].tolist() == by_hand, "whatever is multiplied beside it"


def test_solutions_are_those_of_numpy() -> None:
    root = RNG.normal(size=(3, 1, 4, 4))
    a, b = root @ transposed(root) + np.eye(4), RNG.normal(size=(5, 4, 2))
    found = solve_positive_definite(a, b)
    assert found.shape == (3, 5, 4, 2)
    np.testing.assert_allclose(a @ found, np.broadcast_to(b, found.shape), atol=1e-12)
    assert solve_positive_definite(np.zeros((0, 4, 4)), np.zeros((0, 4, 1))).shape == (0, 4, 1)


def test_transforms_compose_and_rotate_as_matrices_do() -> None:
    a, b = from_yaw(0.3, np.array([1.0, 2.0, 3.0])), from_yaw(-1.1, np.array([4.0, 0.0, 1.0]))
    np.testing.assert_allclose(compose(a, b), a @ b, atol=1e-15)
    vectors = RNG.normal(size=(6, 3))
    np.testing.assert_allclose(rotate(a, vectors), vectors @ a[:3, :3].T, atol=1e-15)
    assert rotate(a, vectors[:0]).shape == (0, 3)
