"""The network: from two sweeps of points to boxes, and to vision-language features of points.

PointPillars (Lang et al., CVPR 2019) with the distillation head of UP-VL (Section 3.4). All norms are over one
sample only, so that a batch gives what its samples give alone, in one process or in several.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from upvl_cli.detector.config import DetectorConfig, ModelConfig
from upvl_cli.detector.data.batch import FEATURE_DIM, Batch
from upvl_cli.detector.grid import Grid
from upvl_cli.detector.heads.anchors import Anchors
from upvl_cli.detector.heads.base import RESIDUAL_DIM, STRIDE, Head
from upvl_cli.detector.heads.centers import Centers
from upvl_cli.errors import BadSetting

_OBJECTNESS_PRIOR = (
    0.01  # objectness of an anchor before training (RetinaNet, Lin et al., ICCV 2017, Section 4.1)
)
_RAW_DIMS = 5  # values of a point that go into its feature: x, y, z, intensity, elongation
_POINT_DIMS = 6  # values of a point that go into its pillar: x, y from the pillar's centre, z, the rest, time
_PILLAR_DIMS = 5  # values that the points of a pillar share: their mean from its centre (3), its place (2)
_GROUP = 8  # channels that a norm averages over


@dataclass(frozen=True)
class Output:
    """Output of the network for a batch.

    Attributes:
        objectness: (b, k) logit of each anchor.
        residual: (b, k, RESIDUAL_DIM) encoded box of each anchor.
        cells: (b, cells, channels) activations of each cell of the output.
    """

    objectness: Tensor
    residual: Tensor
    cells: Tensor


class Detector(nn.Module):
    """Boxes of any class, and vision-language features of points."""

    def __init__(self, config: DetectorConfig, has_distillation_head: bool) -> None:
        """Build the network with random weights.

        Args:
            config: Its view, its width, its head and the sweeps that it takes.
            has_distillation_head: Whether it predicts features of points.

        Raises:
            BadSetting: The width is no multiple of 8, or the anchors have no size.
            BadInput: The grid is empty.
        """
        super().__init__()
        model = config.model
        if model.width < _GROUP or model.width % _GROUP:
            raise BadSetting(f"model.width is {model.width}, expected a multiple of {_GROUP}")
        self.config = config
        self.grid = Grid.of(config.grid)
        self.head = _head_of(self.grid, model)
        self.pillars = _Pillars(self.grid, model.width)
        self.backbone = _Backbone(model.width)
        self.box_head = nn.Conv2d(self.backbone.width, self.head.anchors_per_cell * (1 + RESIDUAL_DIM), 1)
        self.distillation_head = (
            nn.Linear(self.backbone.width + _RAW_DIMS, FEATURE_DIM) if has_distillation_head else None
        )
        self._initialize_box_head()

    def forward(self, batch: Batch) -> Output:
        """Return objectness and boxes; features of points are computed by `features`."""
        cells = self.backbone(self.pillars(batch))  # (b, channels, x, y)
        prediction = self.box_head(cells).permute(0, 2, 3, 1)
        prediction = prediction.reshape(batch.size, -1, 1 + RESIDUAL_DIM).float()  # (b, k, 9)
        return Output(prediction[..., 0], prediction[..., 1:], cells.permute(0, 2, 3, 1).flatten(1, 2))

    def features(self, output: Output, batch: Batch, points: Tensor) -> Tensor:
        """Return (r, 64) features of points: a linear layer on the activations of the cell and the point's values.

        The share of a cell is computed once for all points of the cell.

        Args:
            output: Output of the network for `batch`.
            batch: Points.
            points: (r,) which of them.
        """
        assert self.distillation_head is not None  # without distillation there is no feature
        weight, bias = self.distillation_head.weight, self.distillation_head.bias
        values = batch.points.index_select(0, points)  # three times as quick as an index
        along, across = (pillars // STRIDE for pillars in self.grid.shape)
        column, row = (_pillar_index(values, self.grid, axis) // STRIDE for axis in (0, 1))
        cell = (batch.of_sample.index_select(0, points) * along + column) * across + row
        is_needed = torch.zeros(batch.size * along * across, dtype=torch.bool, device=cell.device)
        is_needed[cell] = True
        needed = is_needed.nonzero()[:, 0]  # as `unique` gives them, without sorting
        of_needed = (torch.cumsum(is_needed, 0) - 1).index_select(0, cell)
        activations = output.cells.flatten(0, 1).index_select(0, needed).float()
        of_cell = functional.linear(activations, weight[:, :-_RAW_DIMS], bias)
        own = _scaled(values, self.grid)[:, :_RAW_DIMS]
        return torch.addmm(of_cell.index_select(0, of_needed), own, weight[:, -_RAW_DIMS:].T)

    def _initialize_box_head(self) -> None:
        """Give all anchors a low objectness and a residual near zero: else negatives drown the first steps."""
        nn.init.normal_(self.box_head.weight, std=0.01)
        bias = torch.zeros(self.head.anchors_per_cell, 1 + RESIDUAL_DIM)
        bias[:, 0] = torch.logit(torch.tensor(_OBJECTNESS_PRIOR))
        with torch.no_grad():
            assert self.box_head.bias is not None
            self.box_head.bias.copy_(bias.flatten())


def _head_of(grid: Grid, config: ModelConfig) -> Head:
    """Return the head that the settings name."""
    if config.box_coder == "anchors":
        return Anchors(grid, config.anchors)
    return Centers(grid, config.centers)


def _pillar_index(points: Tensor, grid: Grid, axis: int) -> Tensor:
    """Return (n,) the number of the pillar of each point along an axis."""
    start = (grid.x_m, grid.y_m)[axis][0]
    number = torch.floor((points[:, axis] - start) / grid.pillar_m).long()
    return number.clamp(0, grid.shape[axis] - 1)  # a float32 point can be rounded onto the far end


def _scaled(points: Tensor, grid: Grid) -> Tensor:
    """Return (n, 6) values of the points, all of about the same size."""
    reach = max(abs(end) for end in (*grid.x_m, *grid.y_m))
    scale = torch.tensor([1 / reach, 1 / reach, 0.5, 1, 1, 10], dtype=points.dtype, device=points.device)
    return points * scale


class _Pillars(nn.Module):
    """From points to (b, width, x, y): the maximum over the points of a pillar, 0 where there are none.

    A linear layer on a point's values, its offset from the pillar's centre and its offset from the mean of the
    pillar's points, then the maximum over the pillar. What all points of a pillar share (where the centre and
    the mean are) only shifts the maximum, so that part of the layer is applied once a pillar, and so is the norm.
    """

    def __init__(self, grid: Grid, width: int) -> None:
        super().__init__()
        self.grid = grid
        self.point = nn.Linear(_POINT_DIMS, width, bias=False)
        self.pillar = nn.Linear(_PILLAR_DIMS, width)
        self.norm = nn.LayerNorm(width)

    def forward(self, batch: Batch) -> Tensor:
        along, across = self.grid.shape
        column, row = (_pillar_index(batch.points, self.grid, axis) for axis in (0, 1))
        pillar = (batch.of_sample * along + column) * across + row
        count = torch.bincount(pillar, minlength=batch.size * along * across)
        filled = count.nonzero()[:, 0]  # about a tenth: all that follows is computed for these alone
        of_filled = (torch.cumsum(count > 0, 0) - 1).index_select(0, pillar)
        own = self._own(batch.points, column, row)
        of_point = self.point(own)
        empty = of_point.new_zeros(len(filled), of_point.shape[1])
        maximum = empty.scatter_reduce(
            0, of_filled[:, None].expand_as(of_point), of_point, "amax", include_self=False
        )
        shared = self.pillar(self._shared(own, of_filled, filled, count.index_select(0, filled)))
        activations = functional.relu(self.norm(maximum + shared))
        canvas = activations.new_zeros(len(count), activations.shape[1]).index_copy(0, filled, activations)
        # The channels of a cell lie side by side in memory, as convolutions like it.
        return canvas.view(batch.size, along, across, -1).permute(0, 3, 1, 2)

    def _own(self, points: Tensor, column: Tensor, row: Tensor) -> Tensor:
        """Return (n, 6) values of each point, with x and y from the pillar's centre."""
        own, side = _scaled(points, self.grid), self.grid.pillar_m
        own[:, 0] = (points[:, 0] - self.grid.x_m[0]) / side - column - 0.5
        own[:, 1] = (points[:, 1] - self.grid.y_m[0]) / side - row - 0.5
        return own

    def _shared(self, own: Tensor, of_filled: Tensor, filled: Tensor, count: Tensor) -> Tensor:
        """Return (f, 5) the mean of each filled pillar's points from its centre, and where its centre is."""
        mean = own.new_zeros(len(filled), 3).index_add(0, of_filled, own[:, :3]) / count[:, None]
        along, across = self.grid.shape
        column, row = filled // across % along, filled % across
        position = torch.stack([2 * column / (along - 1) - 1, 2 * row / (across - 1) - 1], dim=1)
        return torch.cat([mean, position.to(mean.dtype)], dim=1)


class _Backbone(nn.Module):
    """From (b, width, x, y) pillars to (b, 4 width, x / 2, y / 2): three scales, added up."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = 4 * width
        sides = (width, 2 * width, 4 * width)
        before = (width, *sides[:-1])
        self.down = nn.ModuleList(
            nn.Sequential(_ConvNorm(a, b, 2), _ConvNorm(b, b, 1), _ConvNorm(b, b, 1))
            for a, b in zip(before, sides, strict=True)
        )
        self.level = nn.ModuleList(nn.Conv2d(side, 2 * width, 1, bias=False) for side in sides)
        self.mix = _ConvNorm(2 * width, 4 * width, 1)

    def forward(self, canvas: Tensor) -> Tensor:
        scales = []
        for down in self.down:
            canvas = down(canvas)
            scales.append(canvas)
        total: Tensor | None = None
        for level, scale in zip(reversed(self.level), reversed(scales), strict=True):
            lateral = level(scale)
            total = lateral if total is None else lateral + functional.interpolate(total, scale_factor=2.0)
        assert total is not None
        mixed: Tensor = self.mix(total)
        return mixed


class _ConvNorm(nn.Module):
    """A convolution, its norm and a ReLU."""

    def __init__(self, before: int, after: int, stride: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(before, after, 3, stride, 1, bias=False)
        self.norm = nn.GroupNorm(after // _GROUP, after)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(self.conv(x)))
