"""Products and solutions of small matrices whose every bit is the same on any processor.

BLAS picks its kernels by the processor, and each sums in an order of its own. Here each sum runs in the order of
the index, without fused multiply-add: for matrices of a few rows that costs little.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array


def product(a: Array, b: Array) -> Array:
    """Return the matrix products `a @ b`.

    Args:
        a: (..., n, k) matrices.
        b: (..., k, m) matrices; leading axes broadcast with those of `a`.
    """
    total = a[..., :, :1] * b[..., :1, :]
    for k in range(1, a.shape[-1]):
        total = total + a[..., :, k : k + 1] * b[..., k : k + 1, :]
    return np.asarray(total)


def transposed(a: Array) -> Array:
    """Return the transpose of each matrix.

    Args:
        a: (..., n, m) matrices.
    """
    return np.swapaxes(a, -1, -2)


def solve_positive_definite(a: Array, b: Array) -> Array:
    """Return x of `a x = b`, by Gauss-Jordan elimination: a positive definite matrix needs no pivoting.

    Golub and Van Loan, Matrix Computations, section 4.2.

    Args:
        a: (..., n, n) symmetric positive definite matrices.
        b: (..., n, m) right-hand sides; leading axes broadcast with those of `a`.
    """
    shape = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    size = a.shape[-1]
    left, right = (np.broadcast_to(part, (*shape, *part.shape[-2:])) for part in (a, b))
    system = np.concatenate([left, right], axis=-1)
    for pivot in range(size):
        row = system[..., pivot : pivot + 1, :] / system[..., pivot : pivot + 1, pivot : pivot + 1]
        system = system - system[..., :, pivot : pivot + 1] * row
        system[..., pivot : pivot + 1, :] = row
    return np.asarray(system[..., size:])
