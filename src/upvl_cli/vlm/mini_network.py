"""The image network of `mini`: a small convolutional network that embeds pixels in the space of the words.

Trunk: EfficientNet-Lite0 (Tan and Le, "EfficientNet", ICML 2019; the Lite family has no squeeze and no
swish) without its classifier. Neck: a feature pyramid (Lin et al., CVPR 2017) down to a quarter of the picture.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

STRIDE = 32  # a picture's sides must be multiples of this
CELL = 4  # pixels of the picture a cell of the output
# Channels out, blocks, kernel, stride, growth of each stage; the last block of those marked feeds the neck.
_STAGES = (
    (16, 1, 3, 1, 1), (24, 2, 3, 2, 6), (40, 2, 5, 2, 6), (80, 3, 3, 2, 6),
    (112, 3, 5, 1, 6), (192, 4, 5, 2, 6), (320, 1, 3, 1, 6),
)  # fmt: skip
_FEEDS = (1, 2, 4, 6)  # at 1/4, 1/8, 1/16 and 1/32 of the picture
_WIDE, _NARROW = 128, 64


class _MiniConv(nn.Module):
    """A convolution, its norm, and ReLU6 where it has one."""

    def __init__(
        self, before: int, after: int, kernel: int, *, stride: int = 1, groups: int = 1, cut: bool = True
    ):
        super().__init__()
        self.conv = nn.Conv2d(before, after, kernel, stride, kernel // 2, groups=groups, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(after, eps=1e-3, momentum=0.01)
        self.cut = cut

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm(self.conv(x))
        # Not in place, the cut alone takes a quarter of the time.
        return functional.relu6(x, inplace=True) if self.cut else x


class _Block(nn.Module):
    """An inverted residual (Sandler et al., "MobileNetV2", CVPR 2018)."""

    def __init__(self, before: int, after: int, kernel: int, stride: int, growth: int):
        super().__init__()
        inside = before * growth
        self.grow = _MiniConv(before, inside, 1) if growth > 1 else nn.Identity()
        self.look = _MiniConv(inside, inside, kernel, stride=stride, groups=inside)
        self.shrink = _MiniConv(inside, after, 1, cut=False)
        self.keeps = stride == 1 and before == after

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.shrink(self.look(self.grow(x)))
        return y.add_(x) if self.keeps else y


class MiniNetwork(nn.Module):
    """From (n, 3, h, w) pictures, 0 to 255, to (n, dim, h / 4, w / 4) features of no fixed length."""

    def __init__(self, dim: int) -> None:
        """Build the layers; weights are loaded afterwards."""
        super().__init__()
        self.stem = _MiniConv(3, 32, 3, stride=2)
        self.stages = nn.ModuleList()
        before = 32
        for after, blocks, kernel, stride, growth in _STAGES:
            stage = nn.Sequential()
            for number in range(blocks):
                stage.append(_Block(before, after, kernel, stride if number == 0 else 1, growth))
                before = after
            self.stages.append(stage)
        fine, middle, coarse, coarsest = (_STAGES[number][0] for number in _FEEDS)
        self.scene = nn.Conv2d(coarsest, _WIDE, 1)
        self.sides = nn.ModuleList(
            [
                _MiniConv(coarsest, _WIDE, 1, cut=False),
                _MiniConv(coarse, _WIDE, 1, cut=False),
                _MiniConv(middle, _WIDE, 1, cut=False),
            ]
        )
        self.mixes = nn.ModuleList([_MiniConv(_WIDE, _WIDE, 3) for _ in self.sides])
        self.fine = _MiniConv(fine, _NARROW, 1, cut=False)
        self.thin = _MiniConv(_WIDE, _NARROW, 1, cut=False)
        self.last = _MiniConv(_NARROW, _NARROW, 3)
        self.point = nn.Conv2d(_NARROW, dim, 1)

    def fuse(self) -> MiniNetwork:
        """Fold the norms into the convolutions, for use without training; returns itself."""
        for module in self.modules():
            if isinstance(module, _MiniConv):
                module.conv = fuse_conv_bn_eval(module.conv, module.norm)  # type: ignore[arg-type]
                module.norm = nn.Identity()
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return self

    def forward(self, rgb: Tensor) -> Tensor:
        """Return (n, dim, h / 4, w / 4) features of (n, 3, h, w) pictures."""
        x = self.stem((rgb - 127.0) / 128.0)
        feeds = []
        for number, stage in enumerate(self.stages):
            x = stage(x)
            if number in _FEEDS:
                feeds.append(x)
        # Global context: the mean of the coarsest features.
        y = self.scene(x.mean(dim=(2, 3), keepdim=True))
        for side, mix, feed in zip(self.sides, self.mixes, reversed(feeds[1:]), strict=True):
            wide = y if y.shape[-2:] in ((1, 1), feed.shape[-2:]) else _twice(y)
            y = mix(functional.relu(side(feed) + wide))
        y = functional.relu(self.fine(feeds[0]) + _twice(self.thin(y)))
        features: Tensor = self.point(self.last(y))
        return features


def _twice(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
