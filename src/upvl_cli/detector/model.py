"""The network: two sweeps of points in, boxes and features of the vision-language space out.

PointPillars (Lang et al., CVPR 2019) with the distillation head of UP-VL (Section 3.4). All norms look at one
sample only, so that a batch gives what its samples give alone, in one process or in several.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from upvl_cli.detector.anchors import Anchors
from upvl_cli.detector.batch import FEATURE, Batch, Grid
from upvl_cli.detector.centres import Centres
from upvl_cli.detector.head import RESIDUAL, STRIDE, Head
from upvl_cli.errors import BadSetting

HEADS: dict[str, type[Anchors] | type[Centres]] = {"anchors": Anchors, "centres": Centres}
_RARE = 0.01  # objectness of a place before training (RetinaNet, Lin et al., ICCV 2017)
_RAW = 5  # values of a point that go into its feature: x, y, z, intensity, elongation
_POINT = 6  # values of a point that go into its pillar: x, y from the pillar's centre, z, the rest, time
_PILLAR = 5  # values that the points of a pillar share: their mean from its centre (3), its place (2)
_GROUP = 8  # channels a norm looks at together


@dataclass(frozen=True)
class Output:
    """What the network says of a batch.

    Attributes:
        objectness: (b, k) logit of each place.
        residual: (b, k, RESIDUAL) numbers of the box of each place.
        cells: (b, cells, channels) what the network knows of each cell of the output.
    """

    objectness: Tensor
    residual: Tensor
    cells: Tensor


class Detector(nn.Module):
    """Boxes of any class, and the feature of each point."""

    def __init__(self, grid: Grid, width: int, encoder: str, distils: bool) -> None:
        """Build it with random weights.

        Args:
            grid: What it sees.
            width: Channels of a pillar; a multiple of 8. The rest of the network grows with it.
            encoder: Which of `HEADS` says where boxes are.
            distils: Whether it has the head for features.

        Raises:
            BadSetting: There is no such encoder, or the width is none.
        """
        super().__init__()
        if encoder not in HEADS:
            raise BadSetting(f"encoder is {encoder!r}, expected one of: {', '.join(HEADS)}")
        if width < _GROUP or width % _GROUP:
            raise BadSetting(f"width is {width}, expected a multiple of {_GROUP}")
        self.grid = grid
        self.head: Head = HEADS[encoder](grid)
        self.pillars = _Pillars(grid, width)
        self.backbone = _Backbone(width)
        self.says = nn.Conv2d(self.backbone.width, self.head.each_cell * (1 + RESIDUAL), 1)
        self.tells = nn.Linear(self.backbone.width + _RAW, FEATURE) if distils else None
        self._start_quiet()

    def forward(self, batch: Batch) -> Output:
        """Say where boxes are; features of points are asked for with `features`."""
        seen = self.backbone(self.pillars(batch))  # (b, channels, x, y)
        said = self.says(seen).permute(0, 2, 3, 1)
        said = said.reshape(batch.size, -1, 1 + RESIDUAL).float()  # (b, k, 9)
        return Output(said[..., 0], said[..., 1:], seen.permute(0, 2, 3, 1).flatten(1, 2))

    def features(self, output: Output, batch: Batch, rows: Tensor) -> Tensor:
        """(r, 64) features of some points: a linear layer on what is known of the cell and the point's values.

        Its share of a cell is computed once for all points of the cell.

        Args:
            output: What the network said of `batch`.
            batch: Points.
            rows: (r,) which of them.
        """
        assert self.tells is not None  # without distillation there is nothing to ask for
        points = batch.points.index_select(0, rows)  # three times as quick as an index
        along, across = (pillars // STRIDE for pillars in self.grid.shape)
        column, row = (_cell(points, self.grid, axis) // STRIDE for axis in (0, 1))
        cell = (batch.of_sample.index_select(0, rows) * along + column) * across + row
        is_asked = torch.zeros(batch.size * along * across, dtype=torch.bool, device=cell.device)
        is_asked[cell] = True
        asked = is_asked.nonzero()[:, 0]  # as `unique` gives them, without sorting
        of_asked = (torch.cumsum(is_asked, 0) - 1).index_select(0, cell)
        known = output.cells.flatten(0, 1).index_select(0, asked).float()
        told = functional.linear(known, self.tells.weight[:, :-_RAW], self.tells.bias)
        own = _scaled(points, self.grid)[:, :_RAW]
        return torch.addmm(told.index_select(0, of_asked), own, self.tells.weight[:, -_RAW:].T)

    def _start_quiet(self) -> None:
        """Nothing is an object at first, and all boxes are those of their places."""
        nn.init.normal_(self.says.weight, std=0.01)
        bias = torch.zeros(self.head.each_cell, 1 + RESIDUAL)
        bias[:, 0] = torch.logit(torch.tensor(_RARE))
        with torch.no_grad():
            assert self.says.bias is not None
            self.says.bias.copy_(bias.flatten())


def _cell(points: Tensor, grid: Grid, axis: int) -> Tensor:
    """(n,) number of the pillar of each point along an axis."""
    start = (grid.x_m, grid.y_m)[axis][0]
    number = torch.floor((points[:, axis] - start) / grid.pillar_m).long()
    return number.clamp(0, grid.shape[axis] - 1)  # a float32 point can be rounded onto the far end


def _scaled(points: Tensor, grid: Grid) -> Tensor:
    """(n, 6) values of the points, all of about the same size."""
    reach = max(abs(end) for end in (*grid.x_m, *grid.y_m))
    scale = torch.tensor([1 / reach, 1 / reach, 0.5, 1, 1, 10], dtype=points.dtype, device=points.device)
    return points * scale


class _Pillars(nn.Module):
    """From points to (b, width, x, y): the largest of what the points of a pillar say, 0 where there are none.

    A linear layer on a point's values, its offset from the pillar's centre and its offset from the mean of the
    pillar's points, then the largest over the pillar. What all points of a pillar share (where the centre and
    the mean are) only shifts the largest, so that part of the layer is applied once a pillar, and so is the norm.
    """

    def __init__(self, grid: Grid, width: int) -> None:
        super().__init__()
        self.grid = grid
        self.point = nn.Linear(_POINT, width, bias=False)
        self.pillar = nn.Linear(_PILLAR, width)
        self.norm = nn.LayerNorm(width)

    def forward(self, batch: Batch) -> Tensor:
        along, across = self.grid.shape
        column, row = (_cell(batch.points, self.grid, axis) for axis in (0, 1))
        pillar = (batch.of_sample * along + column) * across + row
        count = torch.bincount(pillar, minlength=batch.size * along * across)
        filled = count.nonzero()[:, 0]  # about a tenth: all that follows is computed for these alone
        of_filled = (torch.cumsum(count > 0, 0) - 1).index_select(0, pillar)
        own = self._own(batch.points, column, row)
        said = self.point(own)
        empty = said.new_zeros(len(filled), said.shape[1])
        largest = empty.scatter_reduce(
            0, of_filled[:, None].expand_as(said), said, "amax", include_self=False
        )
        shared = self.pillar(self._shared(own, of_filled, filled, count.index_select(0, filled)))
        known = functional.relu(self.norm(largest + shared))
        canvas = known.new_zeros(len(count), known.shape[1]).index_copy(0, filled, known)
        # The channels of a cell lie side by side in memory, as convolutions like it.
        return canvas.view(batch.size, along, across, -1).permute(0, 3, 1, 2)

    def _own(self, points: Tensor, column: Tensor, row: Tensor) -> Tensor:
        """(n, 6) values of each point, with x and y from the pillar's centre."""
        own, side = _scaled(points, self.grid), self.grid.pillar_m
        own[:, 0] = (points[:, 0] - self.grid.x_m[0]) / side - column - 0.5
        own[:, 1] = (points[:, 1] - self.grid.y_m[0]) / side - row - 0.5
        return own

    def _shared(self, own: Tensor, of_filled: Tensor, filled: Tensor, count: Tensor) -> Tensor:
        """(f, 5) the mean of each filled pillar's points from its centre, and where its centre is."""
        mean = own.new_zeros(len(filled), 3).index_add(0, of_filled, own[:, :3]) / count[:, None]
        along, across = self.grid.shape
        column, row = filled // across % along, filled % across
        place = torch.stack([2 * column / (along - 1) - 1, 2 * row / (across - 1) - 1], dim=1)
        return torch.cat([mean, place.to(mean.dtype)], dim=1)


class _Backbone(nn.Module):
    """From (b, width, x, y) pillars to (b, 4 width, x / 2, y / 2): three scales, brought together."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = 4 * width
        sides = (width, 2 * width, 4 * width)
        before = (width, *sides[:-1])
        self.down = nn.ModuleList(
            nn.Sequential(_Conv(a, b, 2), _Conv(b, b, 1), _Conv(b, b, 1))
            for a, b in zip(before, sides, strict=True)
        )
        self.level = nn.ModuleList(nn.Conv2d(side, 2 * width, 1, bias=False) for side in sides)
        self.mix = _Conv(2 * width, 4 * width, 1)

    def forward(self, canvas: Tensor) -> Tensor:
        scales = []
        for down in self.down:
            canvas = down(canvas)
            scales.append(canvas)
        total: Tensor | None = None
        for level, scale in zip(reversed(self.level), reversed(scales), strict=True):
            here = level(scale)
            total = here if total is None else here + functional.interpolate(total, scale_factor=2.0)
        assert total is not None
        mixed: Tensor = self.mix(total)
        return mixed


class _Conv(nn.Module):
    """A convolution, its norm and its cut at 0."""

    def __init__(self, before: int, after: int, stride: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(before, after, 3, stride, 1, bias=False)
        self.norm = nn.GroupNorm(after // _GROUP, after)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(self.conv(x)))
