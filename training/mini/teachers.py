"""The networks that label real pictures when `mini` is trained; none of them goes into the package.

Each takes a (h, w, 3) uint8 picture in RGB. Dense ones give the class of each pixel in Cityscapes' 19
(`CITYSCAPES`); the detector gives boxes of road users; the classifier gives soft targets of a crop.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from espnetv2 import MEAN, STD
from PIL import Image
from torch import Tensor, nn
from torch.nn import functional

from upvl_cli.boxes2d.base import CameraPicture
from upvl_cli.boxes2d.config import SuppressionConfig
from upvl_cli.boxes2d.onnx import YoloxDetector
from upvl_cli.types import Array, Floats
from upvl_cli.vlm.cityscapes import WORDS_OF

CITYSCAPES = tuple(WORDS_OF)
# Of COCO's kinds those of the street, with their class of Cityscapes.
COCO_STREET = {
    "person": "person", "bicycle": "bicycle", "car": "car", "motorcycle": "motorcycle", "bus": "bus",
    "train": "train", "truck": "truck",
}  # fmt: skip


class Found(NamedTuple):
    """Boxes of a picture: (n, 4) corners x0, y0, x1, y1 in pixels, (n,) scores, (n,) classes of `CITYSCAPES`."""

    xyxy_px: Floats
    score: Floats
    kind: Array


class Yolox:
    """YOLOX-nano on COCO, as `boxes2d` runs it: the whole picture, and tiles at native scale."""

    def __init__(self, path: Path, least: float = 0.25):
        self.detector = YoloxDetector(str(path), SuppressionConfig((1.0,), 0.25, 0.5))
        self.least = least

    def __call__(self, rgb: Array) -> Found:
        """Return the boxes of road users, best first."""
        boxes = self.detector.boxes(CameraPicture(0, "", rgb))
        boxes = boxes[np.isin(boxes.name, list(COCO_STREET)) & (boxes.score >= self.least)]
        kind = np.array([CITYSCAPES.index(COCO_STREET[name]) for name in boxes.name.tolist()], dtype=np.int64)
        return Found(boxes.xyxy_px, boxes.score, kind)


class DeepLab:
    """DeepLab v3 on MobileNet-EdgeTPU slim, 8 bit, of Cityscapes; run by ai-edge-litert."""

    def __init__(self, path: Path):
        from ai_edge_litert.interpreter import Interpreter

        self.network = Interpreter(str(path), num_threads=1)
        self.network.allocate_tensors()
        self.input = self.network.get_input_details()[0]["index"]
        self.output = self.network.get_output_details()[0]["index"]

    def __call__(self, rgb: Array) -> Array:
        """Return the (h, w) class of each pixel."""
        picture = Image.fromarray(rgb)
        self.network.set_tensor(
            self.input, np.asarray(picture.resize((513, 513), Image.Resampling.BILINEAR))[None]
        )
        self.network.invoke()
        classes = self.network.get_tensor(self.output)[0].astype(np.uint8)
        return np.asarray(Image.fromarray(classes).resize(picture.size, Image.Resampling.NEAREST))


class Dense:
    """A network of logits of Cityscapes' 19 classes, of pictures normalised as ImageNet's."""

    def __init__(self, network: nn.Module, long_side: int = 1024):
        self.network, self.long_side = network, long_side

    @torch.inference_mode()
    def __call__(self, rgb: Array) -> Array:
        """Return the (h, w) class of each pixel; small pictures are enlarged to twice their size at most."""
        height, width, _ = rgb.shape
        scale = min(self.long_side / max(height, width), 2.0)
        size = [max(32, round(side * scale / 32) * 32) for side in (height, width)]
        pixels = torch.tensor(rgb).permute(2, 0, 1)[None].float() / 255
        pixels = (pixels - torch.tensor(MEAN)[:, None, None]) / torch.tensor(STD)[:, None, None]
        logits = self.network(functional.interpolate(pixels, size, mode="bilinear", antialias=scale < 1))
        full = functional.interpolate(logits[:, :19], (height, width), mode="bilinear", align_corners=False)
        return np.asarray(full.argmax(1)[0].to(torch.uint8).numpy())


class LiteHead:
    """EfficientNet-Lite2 with its head of ImageNet's 1 000 kinds (Tan and Le, ICML 2019)."""

    side = 260
    # Channels out, blocks, kernel, stride, growth, times the depth and width of Lite2.
    stages = (
        (16, 1, 3, 1, 1), (24, 3, 3, 2, 6), (48, 3, 5, 2, 6), (88, 4, 3, 2, 6),
        (120, 4, 5, 1, 6), (208, 5, 5, 2, 6), (352, 1, 3, 1, 6),
    )  # fmt: skip

    def __init__(self, path: Path):
        self.weights = torch.load(path, weights_only=True)

    @torch.inference_mode()
    def __call__(self, crops: list[Image.Image]) -> Floats:
        """Return (n, 1000) probabilities."""
        size = (self.side, self.side)
        pixels = np.stack([np.asarray(crop.resize(size, Image.Resampling.BICUBIC)) for crop in crops])
        x = (torch.tensor(pixels).permute(0, 3, 1, 2).float() - 127) / 128
        x = functional.relu6(
            self._norm(functional.conv2d(x, self.weights["_conv_stem.weight"], None, 2, 1), "_bn0")
        )
        number = 0
        for after, blocks, kernel, stride, growth in self.stages:
            for turn in range(blocks):
                x = self._block(x, f"_blocks.{number}.", (after, kernel, stride if turn == 0 else 1, growth))
                number += 1
        x = functional.relu6(
            self._norm(functional.conv2d(x, self.weights["_conv_head.weight"]), "_bn1")
        ).mean((2, 3))
        return np.asarray(
            torch.softmax(x @ self.weights["_fc.weight"].T + self.weights["_fc.bias"], 1).numpy()
        )

    def _block(self, x: Tensor, name: str, of: tuple[int, int, int, int]) -> Tensor:
        after, kernel, stride, growth = of
        y, w = x, self.weights
        if growth > 1:
            y = functional.relu6(
                self._norm(functional.conv2d(y, w[name + "_expand_conv.weight"]), name + "_bn0")
            )
        deep = w[name + "_depthwise_conv.weight"]
        y = functional.conv2d(y, deep, None, stride, kernel // 2, groups=y.shape[1])
        y = functional.relu6(self._norm(y, name + "_bn1"))
        y = self._norm(functional.conv2d(y, w[name + "_project_conv.weight"]), name + "_bn2")
        return x + y if stride == 1 and x.shape[1] == after else y

    def _norm(self, x: Tensor, name: str) -> Tensor:
        w = self.weights
        mean, variance = w[name + ".running_mean"], w[name + ".running_var"]
        return functional.batch_norm(
            x, mean, variance, w[name + ".weight"], w[name + ".bias"], False, 0, 1e-3
        )
