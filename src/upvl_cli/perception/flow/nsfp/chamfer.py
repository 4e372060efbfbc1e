"""Chamfer distance between batches of point sets of different sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from upvl_cli.types import Floats

# On a CPU, two sets with more pairs of points than this are searched by a tree rather than by all distances.
TREE_PAIRS = 2**19
BLOCK_PAIRS = 2**26  # distances that are in memory at once
FAR = 1e12  # squared distance of a place that holds no point


@dataclass(frozen=True)
class PointSets:
    """Point sets side by side, filled up to equal length.

    Attributes:
        xyz_m: (c, p, 3) points of each set, then zeros.
        size: (c,) number of its points.
    """

    xyz_m: Tensor
    size: Tensor

    @classmethod
    def of(cls, sets: Sequence[Floats], device: str) -> PointSets:
        """Return (n, 3) arrays as one batch on that device."""
        length = max((len(points) for points in sets), default=0)
        xyz_m = np.zeros((len(sets), length, 3), np.float32)
        for row, points in zip(xyz_m, sets, strict=True):
            row[: len(points)] = points
        size = torch.tensor([len(points) for points in sets])
        return cls(torch.from_numpy(xyz_m).to(device), size.to(device))

    def __getitem__(self, index: Tensor) -> PointSets:
        """Return the sets of these numbers, no longer than the largest of them."""
        size = self.size[index]
        return PointSets(self.xyz_m[index, : int(size.max())], size)

    @cached_property
    def is_point(self) -> Tensor:
        """(c, p) which places hold a point."""
        return torch.arange(self.xyz_m.shape[1], device=self.size.device) < self.size[:, None]

    @cached_property
    def trees(self) -> list[cKDTree]:
        """A search tree of each set."""
        xyz_m, sizes = self.xyz_m.detach().numpy(), self.size.tolist()
        return [
            cKDTree(points[:size], leafsize=16, compact_nodes=False, balanced_tree=False)
            for points, size in zip(xyz_m, sizes, strict=True)
        ]

    def mean(self, values: Tensor) -> Tensor:
        """Return the (c,) mean over the points of each set of (c, p) values."""
        return (values * self.is_point).sum(1) / self.size


def chamfer(left: PointSets, right: PointSets, max_distance_m: float) -> Tensor:
    """Return the (c,) Chamfer distance of pairs of point sets in square metres, both ways added up.

    Args:
        left: c sets.
        right: c sets.
        max_distance_m: A nearest neighbor farther away counts as one at this distance, without a gradient. NSFP
            itself lets such a term count as 0, with the same gradient; then the best loss is that of points far
            from everything.
    """
    return _one_way(left, right, max_distance_m) + _one_way(right, left, max_distance_m)


def _one_way(queries: PointSets, others: PointSets, max_distance_m: float) -> Tensor:
    index = nearest(queries, others)
    partner_m = others.xyz_m.gather(1, index[..., None].expand(-1, -1, 3))
    squared_m2 = (queries.xyz_m - partner_m).square().sum(-1)
    return queries.mean(squared_m2.clamp(max=max_distance_m**2))


@torch.no_grad()
def nearest(queries: PointSets, others: PointSets) -> Tensor:
    """Return the (c, p) place of the nearest point of the other set; any place where the query holds no point.

    Args:
        queries: c sets of up to p points.
        others: c sets, none of them empty.
    """
    pairs = queries.xyz_m.shape[1] * others.xyz_m.shape[1]
    if pairs > TREE_PAIRS and queries.xyz_m.device.type == "cpu":
        return _nearest_by_trees(queries, others)
    far = torch.where(others.is_point, 0.0, FAR)
    step = max(1, BLOCK_PAIRS // (others.xyz_m.shape[1] * len(queries.size)))
    found = []
    for part_m in torch.split(queries.xyz_m, step, dim=1):
        # Not by a matrix product, which loses the centimetres of clouds that reach far.
        squared_m2 = far[:, None, :].expand(-1, part_m.shape[1], -1)
        for axis in range(3):
            squared_m2 = squared_m2 + (part_m[:, :, None, axis] - others.xyz_m[:, None, :, axis]).square()
        found.append(squared_m2.argmin(2))
    return torch.cat(found, dim=1)


def _nearest_by_trees(queries: PointSets, others: PointSets) -> Tensor:
    index = torch.zeros(queries.xyz_m.shape[:2], dtype=torch.int64)
    sizes = queries.size.tolist()
    for row, points, size, tree in zip(index, queries.xyz_m.numpy(), sizes, others.trees, strict=True):
        row[:size] = torch.from_numpy(tree.query(points[:size])[1])
    return index
