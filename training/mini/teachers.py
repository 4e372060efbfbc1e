"""The networks that label real pictures when `mini` is trained; none of them goes into the package.

Each takes a (h, w, 3) uint8 picture in RGB. Dense ones give the class of each pixel in Cityscapes' 19
(`CITYSCAPES`); the detector gives boxes of road users; the classifier gives soft targets of a crop.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnxruntime
import torch
from PIL import Image
from torch import Tensor, nn
from torch.nn import functional

from upvl_cli.types import Array, Floats

CITYSCAPES = (
    "road", "sidewalk", "building", "wall", "fence", "pole", "traffic light", "traffic sign", "vegetation",
    "terrain", "sky", "person", "rider", "car", "truck", "bus", "train", "motorcycle", "bicycle",
)  # fmt: skip
# Of COCO's 80 kinds, those of the street, as numbers of Cityscapes' classes.
COCO_STREET = {0: 11, 1: 18, 2: 13, 3: 17, 5: 15, 6: 16, 7: 14}
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Found(NamedTuple):
    """Boxes of a picture: (n, 4) corners x0, y0, x1, y1 in pixels, (n,) scores, (n,) classes of `CITYSCAPES`."""

    xyxy_px: Floats
    score: Floats
    kind: Array


class Yolox:
    """YOLOX-nano on COCO (Ge et al., arXiv 2107.08430): tiles at native scale, and the whole picture."""

    side = 416

    def __init__(self, path: Path, least: float = 0.25):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session, self.least = onnxruntime.InferenceSession(str(path), options), least

    def __call__(self, rgb: Array) -> Found:
        """Return the boxes of road users after non-maximum suppression, best first."""
        height, width, _ = rgb.shape
        parts = [self._at(rgb, 0, 0, self.side / max(height, width))]
        if max(height, width) > self.side * 1.3:
            parts += [
                self._at(rgb, x, y, 1.0)
                for y in _starts(height, self.side)
                for x in _starts(width, self.side)
            ]
        boxes, score, kind = (np.concatenate(column) for column in zip(*parts, strict=True))
        kept = _suppressed(boxes, score, kind, 0.5)
        return Found(boxes[kept], score[kept], kind[kept])

    def _at(self, rgb: Array, x: int, y: int, scale: float) -> tuple[Floats, Floats, Array]:
        picture = Image.fromarray(rgb)
        if scale != 1.0:
            picture = picture.resize([round(side * scale) for side in picture.size], Image.Resampling.BICUBIC)
        part = np.asarray(picture)[y : y + self.side, x : x + self.side]
        canvas = np.full((self.side, self.side, 3), 114, dtype=np.float32)
        canvas[: part.shape[0], : part.shape[1]] = part[..., ::-1]
        (out,) = self.session.run(None, {"images": canvas.transpose(2, 0, 1)[None]})
        boxes, score, kind = self._decoded(out[0])
        # A box that a tile cuts is one of the part only: the whole picture has it, or another tile.
        inner = [x > 0, y > 0, x + self.side < picture.width, y + self.side < picture.height]
        edges = np.stack(
            [boxes[:, 0] < 2, boxes[:, 1] < 2, boxes[:, 2] > self.side - 2, boxes[:, 3] > self.side - 2]
        )
        whole = ~(edges & np.array(inner)[:, None]).any(axis=0)
        return ((boxes + [x, y, x, y]) / scale)[whole], score[whole], kind[whole]

    def _decoded(self, out: Floats) -> tuple[Floats, Floats, Array]:
        cells = []
        for stride in (8, 16, 32):
            row, column = np.mgrid[: self.side // stride, : self.side // stride].reshape(2, -1)
            cells.append(np.column_stack([column, row, np.full(row.size, stride)]))
        column, row, stride = np.concatenate(cells).T
        centre = (out[:, :2] + np.column_stack([column, row])) * stride[:, None]
        half = np.exp(out[:, 2:4]) * stride[:, None] / 2
        numbers = np.array(list(COCO_STREET))
        shares = out[:, 4:5] * out[:, 5:][:, numbers]
        best = shares.argmax(axis=1)
        score = shares[np.arange(len(best)), best]
        kept = score >= self.least
        kinds = np.array(list(COCO_STREET.values()))[best]
        return np.hstack([centre - half, centre + half])[kept], score[kept], kinds[kept]


def _starts(whole: int, side: int) -> list[int]:
    """Where tiles begin that overlap by a quarter at least."""
    count = max(1, math.ceil((whole - side / 4) / (side * 3 / 4)))
    return (
        [round(i * max(whole - side, 0) / max(count - 1, 1)) for i in range(count)] if whole > side else [0]
    )


def _suppressed(boxes: Floats, score: Floats, kind: Array, most: float) -> Array:
    order, kept = np.argsort(-score, kind="stable"), []
    for i in order:
        over = [
            _iou(boxes[i], boxes[k]) for k in kept if kind[k] == kind[i] or _iou(boxes[i], boxes[k]) > 0.8
        ]
        if not over or max(over) < most:
            kept.append(i)
    return np.array(kept, dtype=np.int64)


def _iou(a: Floats, b: Floats) -> float:
    side = np.clip(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0, None)
    inside = side.prod()
    return float(inside / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - inside + 1e-9))


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
        pixels = (pixels - torch.tensor(MEAN)[:, None, None]) / torch.tensor(DEVIATION)[:, None, None]
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
