"""ESPNetv2 for segmentation, and its mean IoU on CamVid: python training/mini/espnetv2.py WEIGHTS CAMVID.

The network of Mehta et al., "ESPNetv2: A Light-weight, Power Efficient, and General Purpose Convolutional Neural
Network" (arXiv 1811.11431, CVPR 2019), at width 2.0 with 20 outputs: the 19 classes of Cityscapes in their usual
order, and background. It labels pictures when `mini` is trained; nothing of it goes into the package. Modules
are named after the keys of the published weights.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np
import torch
from evaluate import iou
from PIL import Image
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional

from upvl_cli.vlm.cityscapes import WORDS_OF

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of RGB from 0 to 1, those of ImageNet
WIDTHS = (32, 128, 256, 512)  # channels at strides 2, 4, 8 and 16
DECODER_WIDTHS = (64, 48, 32, 20)
BRANCHES = 4  # parallel dilated convolutions of a unit
IMAGE_CHANNELS = 3
POOL_WIDTH = 10  # channels of each scale of the pyramid
SCALES = (2.0, 1.5, 1.0, 0.5, 0.1)  # of the pyramid, in its input's size
SMALLEST = 5  # cells of a side of the pyramid


def convolution(
    inputs: int, outputs: int, kernel: int, groups: int = 1, stride: int = 1, dilation: int = 1
) -> nn.Conv2d:
    """Return a convolution without bias that keeps the size at stride 1."""
    reach = dilation * (kernel // 2)
    return nn.Conv2d(inputs, outputs, kernel, stride, reach, dilation, groups, bias=False)


def named(**modules: nn.Module) -> nn.Sequential:
    """Return modules that run one after the other, each under its name."""
    chain = nn.Sequential()
    for name, module in modules.items():
        chain.add_module(name, module)
    return chain


def conv_bn_act(inputs: int, outputs: int, kernel: int, groups: int = 1, stride: int = 1) -> nn.Sequential:
    """Return convolution, batch normalisation and PReLU, as the encoder names them."""
    return named(
        conv=convolution(inputs, outputs, kernel, groups, stride),
        bn=nn.BatchNorm2d(outputs),
        act=nn.PReLU(outputs),
    )


def conv_bn(inputs: int, outputs: int, groups: int = 1) -> nn.Sequential:
    """Return a pointwise convolution and batch normalisation."""
    return named(conv=convolution(inputs, outputs, 1, groups), bn=nn.BatchNorm2d(outputs))


def bn_act(width: int) -> nn.Sequential:
    """Return batch normalisation and PReLU, without names."""
    return nn.Sequential(nn.BatchNorm2d(width), nn.PReLU(width))


def decoder_conv(inputs: int, outputs: int, kernel: int, groups: int = 1) -> nn.Sequential:
    """Return convolution, batch normalisation and PReLU, as the decoder names them."""
    return named(cbr=nn.Sequential(convolution(inputs, outputs, kernel, groups), *bn_act(outputs)))


def dilations(receptive_limit: int) -> list[int]:
    """Return the dilation of each branch, ascending.

    Branch b sees 3 + 2 b pixels; one that would see more than the limit is a plain convolution in its place.
    """
    return sorted(1 + branch if 3 + 2 * branch <= receptive_limit else 1 for branch in range(BRANCHES))


class EespUnit(nn.Module):
    """Reduce, convolve at several dilations, add up from small to large, concatenate, expand (section 3.1)."""

    def __init__(self, inputs: int, outputs: int, receptive_limit: int, stride: int = 1) -> None:
        super().__init__()
        width = outputs // BRANCHES
        self.proj_1x1 = conv_bn_act(inputs, width, 1, groups=BRANCHES)
        self.spp_dw = nn.ModuleList(
            named(conv=convolution(width, width, 3, groups=width, stride=stride, dilation=dilation))
            for dilation in dilations(receptive_limit)
        )
        self.br_after_cat = named(bn=nn.BatchNorm2d(outputs), act=nn.PReLU(outputs))
        self.conv_1x1_exp = conv_bn(outputs, outputs, groups=BRANCHES)
        self.module_act = nn.PReLU(outputs)  # has weights but no use in a unit that halves the size
        self.keeps_size = stride == 1

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, outputs, h / stride, w / stride)."""
        reduced = self.proj_1x1(x)
        fused = [self.spp_dw[0](reduced)]
        for branch in self.spp_dw[1:]:
            fused.append(fused[-1] + branch(reduced))
        expanded = self.conv_1x1_exp(self.br_after_cat(torch.cat(fused, dim=1)))
        return self.module_act(expanded + x) if self.keeps_size else expanded


class Downsampling(nn.Module):
    """Halve the size: pooled input beside a strided unit, plus the picture itself at that size (section 3.2)."""

    def __init__(self, inputs: int, outputs: int, receptive_limit: int) -> None:
        super().__init__()
        self.eesp = EespUnit(inputs, outputs - inputs, receptive_limit, stride=2)
        self.inp_reinf = nn.Sequential(
            conv_bn_act(IMAGE_CHANNELS, IMAGE_CHANNELS, 3), conv_bn(IMAGE_CHANNELS, outputs)
        )
        self.act = nn.PReLU(outputs)

    def forward(self, x: Tensor, picture: Tensor) -> Tensor:
        """Return (n, outputs, h / 2, w / 2); `picture` has that size already."""
        return self.act(torch.cat([halved(x), self.eesp(x)], dim=1) + self.inp_reinf(picture))


def halved(x: Tensor) -> Tensor:
    """Return means over 3 x 3 pixels, at stride 2."""
    return functional.avg_pool2d(x, 3, stride=2, padding=1)


def resized(x: Tensor, size: tuple[int, int]) -> Tensor:
    """Return bilinear samples, the corners of both grids on each other."""
    return functional.interpolate(x, size, mode="bilinear", align_corners=True)


class ChannelShuffle(nn.Module):
    """Put the first channel of every scale first, then the second of every scale, and so on."""

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, c, h, w)."""
        return x.unflatten(1, (len(SCALES), -1)).transpose(1, 2).flatten(1, 2)


class PyramidPool(nn.Module):
    """Depthwise convolutions at several sizes of the input, merged."""

    def __init__(self, inputs: int, outputs: int, last: bool = False) -> None:
        super().__init__()
        joined = POOL_WIDTH * len(SCALES)
        self.projection_layer = decoder_conv(inputs, POOL_WIDTH, 1)
        self.stages = nn.ModuleList(convolution(POOL_WIDTH, POOL_WIDTH, 3, groups=POOL_WIDTH) for _ in SCALES)
        self.merge_layer = nn.Sequential(
            named(br=bn_act(joined)),
            ChannelShuffle(),
            decoder_conv(joined, POOL_WIDTH, 3, groups=POOL_WIDTH),
            nn.Conv2d(POOL_WIDTH, outputs, 1, bias=last),
        )
        self.br = nn.Identity() if last else named(br=bn_act(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, outputs, h, w)."""
        x = self.projection_layer(x)
        scaled = [self._at(x, scale, stage) for scale, stage in zip(SCALES, self.stages, strict=True)]
        return self.br(self.merge_layer(torch.cat(scaled, dim=1)))

    @staticmethod
    def _at(x: Tensor, scale: float, stage: nn.Module) -> Tensor:
        """Return what a convolution gives at another size, brought back to the size of its input."""
        height, width = x.shape[-2:]
        size = (max(SMALLEST, math.ceil(height * scale)), max(SMALLEST, math.ceil(width * scale)))
        if scale < 1:
            return resized(stage(functional.adaptive_avg_pool2d(x, size)), (height, width))
        if scale > 1:
            return functional.adaptive_avg_pool2d(stage(resized(x, size)), (height, width))
        return stage(x)


class WeightedProjection(nn.Module):
    """Project features of the encoder; the means over the picture weigh the channels."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.wt_layer = nn.Sequential(
            nn.AdaptiveAvgPool2d(1), nn.Conv2d(inputs, outputs, 1, bias=False), nn.Sigmoid()
        )
        self.expansion_layer = decoder_conv(inputs, outputs, 3, groups=math.gcd(inputs, outputs))

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, outputs, h, w)."""
        return self.expansion_layer(x) * self.wt_layer(x)


class Encoder(nn.Module):
    """The trunk, without the level of stride 32 that only classification uses."""

    def __init__(self) -> None:
        super().__init__()
        first, second, third, fourth = WIDTHS
        self.level1 = conv_bn_act(IMAGE_CHANNELS, first, 3, stride=2)
        self.level2_0 = Downsampling(first, second, 13)
        self.level3_0 = Downsampling(second, third, 11)
        self.level3 = nn.Sequential(*(EespUnit(third, third, 9) for _ in range(3)))
        self.level4_0 = Downsampling(third, fourth, 9)
        self.level4 = nn.Sequential(*(EespUnit(fourth, fourth, 7) for _ in range(7)))

    def forward(self, picture: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return features at strides 2, 4, 8 and 16."""
        quarter = halved(halved(picture))
        eighth = halved(quarter)
        first = self.level1(picture)
        second = self.level2_0(first, quarter)
        third = self.level3(self.level3_0(second, eighth))
        return first, second, third, self.level4(self.level4_0(third, halved(eighth)))


class EspNetV2(nn.Module):
    """Encoder, and a decoder that adds the encoder's features at each doubling of the size."""

    def __init__(self) -> None:
        super().__init__()
        self.base_net = Encoder()
        first, second, third, last = DECODER_WIDTHS
        self.bu_dec_l1 = PyramidPool(WIDTHS[3], first)
        self.bu_dec_l2 = PyramidPool(first, second)
        self.bu_dec_l3 = PyramidPool(second, third)
        self.bu_dec_l4 = PyramidPool(third, last, last=True)
        self.merge_enc_dec_l2 = WeightedProjection(WIDTHS[2], first)
        self.merge_enc_dec_l3 = WeightedProjection(WIDTHS[1], second)
        self.merge_enc_dec_l4 = WeightedProjection(WIDTHS[0], third)
        self.bu_br_l2, self.bu_br_l3, self.bu_br_l4 = bn_act(first), bn_act(second), bn_act(third)

    def forward(self, picture: Tensor) -> Tensor:
        """Return (n, 20, h, w) logits of (n, 3, h, w) RGB, normalised by `MEAN` and `STD`."""
        first, second, third, fourth = self.base_net(picture)
        x = self.bu_dec_l1(fourth)
        x = self.bu_dec_l2(self.bu_br_l2(doubled(x) + self.merge_enc_dec_l2(third)))
        x = self.bu_dec_l3(self.bu_br_l3(doubled(x) + self.merge_enc_dec_l3(second)))
        x = self.bu_dec_l4(self.bu_br_l4(doubled(x) + self.merge_enc_dec_l4(first)))
        return resized(x, (picture.shape[2], picture.shape[3]))


def doubled(x: Tensor) -> Tensor:
    """Return features at twice the size."""
    return resized(x, (2 * x.shape[2], 2 * x.shape[3]))


def open_espnetv2(path: Path) -> nn.Module:
    """Return the network with the weights of a safetensors file, ready to label.

    It takes (n, 3, h, w) float32 RGB, normalised by `MEAN` and `STD`, sides multiples of 32, and gives
    (n, 20, h, w) logits: the classes of `WORDS_OF`, then background.
    """
    network = EspNetV2()
    network.load_state_dict(load_file(path), strict=True)
    return network.eval()


# Which class of CamVid shows each of Cityscapes: its sets of words, as its authors grouped them.
CAMVID_OF = {
    "wall": "building", "traffic light": "traffic sign", "vegetation": "tree", "terrain": "tree",
    "person": "pedestrian", "rider": "bicyclist", "motorcycle": "bicyclist", "bicycle": "bicyclist",
    "truck": "car", "bus": "car", "train": "car",
}  # fmt: skip


def camvid_miou(
    network: nn.Module, root: Path, every: int, size: tuple[int, int]
) -> tuple[np.ndarray, float]:
    """Return the IoU of CamVid's 11 classes on its test pictures, and the CPU seconds of one picture.

    Args:
        network: Gives logits.
        root: Folder of CamVid.
        every: Step between pictures.
        size: (width, height) in pixels at which the network sees a picture.
    """
    classes = [line for line in (root / "classes.txt").read_text().splitlines() if line][:11]
    camvid_of = np.array([classes.index(CAMVID_OF.get(name, name)) for name in WORDS_OF])
    confusion, seconds = np.zeros((11, 11), dtype=np.int64), 0.0
    paths = sorted((root / "test").glob("*.jpg"))[::every]
    for path in paths:
        label = np.asarray(Image.open(root / "testannot" / f"{path.stem}.png"))
        rgb = Image.open(path).convert("RGB").resize(size, Image.Resampling.BILINEAR)
        pixels = (np.asarray(rgb, dtype=np.float32) / 255 - np.float32(MEAN)) / np.float32(STD)
        started = time.process_time()
        with torch.inference_mode():
            logits = network(torch.from_numpy(pixels).permute(2, 0, 1)[None])[:, : len(WORDS_OF)]
        seconds += time.process_time() - started
        full = functional.interpolate(logits, label.shape, mode="bilinear")
        named_class = camvid_of[full.argmax(1)[0].numpy()]
        known = label < 11
        pairs = label[known] * 11 + named_class[known]
        confusion += np.bincount(pairs, minlength=121).reshape(11, 11)
    return iou(confusion), seconds / max(1, len(paths))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("camvid", type=Path)
    parser.add_argument("--every", type=int, default=1, help="step between test pictures")
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480), help="width and height in pixels")
    options = parser.parse_args()
    torch.set_num_threads(1)
    network = open_espnetv2(options.weights)
    each, seconds = camvid_miou(network, options.camvid, options.every, tuple(options.size))
    print("mean IoU", round(float(each.mean()), 3), "each", np.round(each, 3).tolist())
    print("seconds of one core a picture:", round(seconds, 3))


if __name__ == "__main__":
    main()
