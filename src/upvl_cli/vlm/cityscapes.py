"""A segmentation network with the classes of Cityscapes, as a model that any word can be asked of.

The classes are those of M. Cordts et al., "The Cityscapes Dataset for Semantic Urban Scene Understanding" (CVPR 2016).
A pixel's feature is the mean of its classes' words, weighed by their probabilities, in the text space of `mini`: a
synonym finds what its class finds, and a word between two classes finds a little of both. Nothing finer than the
19 classes is there: a fire truck is a truck.
"""

from __future__ import annotations

import glob
import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.runtime.onnx_graph import FLOAT, open_graph, run_graph
from upvl_cli.runtime.parallel import threads
from upvl_cli.types import Array, BackgroundRule, Floats
from upvl_cli.vlm import mini
from upvl_cli.vlm.mini_text import unit
from upvl_cli.vlm.model_card import IMAGE_KEYS, CardKeys, is_integer, read_card

# The classes in the order of their training ids, each with the words whose mean it is.
WORDS_OF: dict[str, tuple[str, ...]] = {
    "road": ("road", "street"),
    "sidewalk": ("sidewalk",),
    "building": ("building",),
    "wall": ("wall",),
    "fence": ("fence",),
    "pole": ("pole",),
    "traffic light": ("traffic light",),
    "traffic sign": ("traffic sign",),
    "vegetation": ("vegetation", "tree"),
    "terrain": ("grass",),
    "sky": ("sky",),
    "person": ("person", "pedestrian"),
    "rider": ("cyclist", "rider"),
    "car": ("car",),
    "truck": ("truck",),
    "bus": ("bus",),
    "train": ("train", "tram"),
    "motorcycle": ("motorcycle",),
    "bicycle": ("bicycle",),
}
CLASSES = len(WORDS_OF)
CELL_PX = 4  # side of the cells that the probabilities are averaged over, as large as those of `mini`
KEYS: CardKeys = IMAGE_KEYS | {
    "channels": ('"rgb" or "bgr"', lambda value: value in ("rgb", "bgr")),
    "longer_side_px": ("a whole number from 1 on", lambda value: is_integer(value) and value > 0),
}


def files(weights: str) -> tuple[Path, ...]:
    """Return the files that make the model: the graph, its JSON file, and the text half of `mini`.

    Raises:
        BadInput: The graph or its JSON file is missing.
    """
    graph = Path(weights).expanduser()
    setting = f'vlm.toml: model = "cityscapes:{weights}"'
    if not weights or not graph.is_file() or graph.suffix != ".onnx":
        raise BadInput(
            f"{setting}: expected a file NAME.onnx, a segmentation network with the {CLASSES} classes of Cityscapes"
        )
    if not graph.with_suffix(".json").is_file():
        raise BadInput(
            f"{setting}: there is no {graph.with_suffix('.json').name} beside it; write it with the keys "
            f"{', '.join(KEYS)} (docs/models.md has an example)"
        )
    # Exporters may lay weights beside the graph, as NAME.onnx.data, NAME.onnx_data or NAME.data.
    data = graph.parent.glob(f"{glob.escape(graph.stem)}.*data")
    beside = sorted([graph, graph.with_suffix(".json"), *data])
    return (*beside, *mini.files("")[1:])


class Cityscapes:
    """A segmentation network and the text half of `mini` (a `Model`).

    Attributes:
        background: Compares with words for objects, as `mini` does. With words of its own classes the two differ
            by more than 0.05, so that 0 is in between.
    """

    background = BackgroundRule(mini.OBJECTS, 0.0)

    def __init__(self, weights: str) -> None:
        """Read the JSON file; the network waits for the first picture.

        Args:
            weights: File of the graph, which has its JSON file beside it.
        """
        files(weights)
        self.name = f"cityscapes:{weights}"
        self._path = Path(weights).expanduser()
        self._card = read_card(self._path.with_suffix(".json"), KEYS)
        self._text = mini.Mini().text

    @property
    def dim(self) -> int:
        """Length of its vectors."""
        return int(self._text.vectors.shape[1])

    def embed_text(self, words: Sequence[str]) -> Floats:
        """Return (t, d) vectors of length 1."""
        return self._text.embed(words)

    def unknown_words(self, phrases: Sequence[str]) -> list[tuple[str, str]]:
        """Return words that are in no table (a `Speller`)."""
        return self._text.unknown_words(phrases)

    def embed_image(self, rgb: Array) -> Floats:
        """Return (h', w', d) features of length 1, a cell `CELL_PX` wide or as wide as the network's cells."""
        return unit(self.class_probabilities(rgb) @ self._class_vectors)

    def class_probabilities(self, rgb: Array) -> Floats:
        """Return (h', w', 19) probabilities of the classes; alike for all where the network names none."""
        pixels, (high, wide) = self._pixels(rgb)
        output = run_graph(self._network, self._path, pixels)
        classes = _probabilities(output, self._path)
        cells_per_px = np.array(classes.shape[:2]) / pixels.shape[2:]
        # The picture fills the upper left; the rest of a network of fixed size is padding.
        rows, columns = (max(1, round(side)) for side in (high, wide) * cells_per_px)
        row_block, column_block = (max(1, round(CELL_PX * scale)) for scale in cells_per_px)
        return _block_means(classes[:rows, :columns], row_block, column_block)

    def _pixels(self, rgb: Array) -> tuple[Floats, tuple[int, int]]:
        """Return (1, 3, h, w) pixels as the network expects them, and the height and width of the picture therein."""
        from PIL import Image

        frame = self._frame
        size = resized_size(rgb.shape[:2], frame, self._card["multiple"], self._card["longer_side_px"])
        picture = Image.fromarray(rgb).resize(size[::-1], Image.Resampling.BILINEAR)
        mean, std = (np.array(self._card[key], dtype=np.float32) for key in ("mean", "std"))
        values = np.asarray(picture, dtype=np.float32)[..., :: -1 if self._card["channels"] == "bgr" else 1]
        pixels = np.zeros((1, 3, *(frame or size)), dtype=np.float32)
        pixels[0, :, : size[0], : size[1]] = ((values / 255 - mean) / std).transpose(2, 0, 1)
        return pixels, size

    @cached_property
    def _frame(self) -> tuple[int, int] | None:
        """Height and width of the only picture that the graph takes; None if it takes any."""
        # A side that may have any length is a name or None.
        shape = [side if isinstance(side, int) else None for side in self._network.get_inputs()[0].shape]
        if len(shape) != 4 or shape[0] not in (1, None) or shape[1] not in (3, None) or shape[3] == 3:
            raise BadInput(
                f"{self._path}: takes an input of shape {tuple(self._network.get_inputs()[0].shape)}, "
                "expected (1, 3, h, w): one picture, channels first"
            )
        high, wide = shape[2:]
        return (high, wide) if high and wide else None

    @cached_property
    def _network(self) -> Any:
        return open_graph(self._path, FLOAT, threads())

    @cached_property
    def _class_vectors(self) -> Floats:
        """(19, d) vectors of the classes, of length 1."""
        return np.stack([unit(self.embed_text(words).mean(axis=0)) for words in WORDS_OF.values()])


def resized_size(
    size: tuple[int, ...], frame: tuple[int, int] | None, multiple: int, longer_side_px: int
) -> tuple[int, int]:
    """Return height and width in pixels of the resized picture: whole cells, in proportion but for part of one.

    Args:
        size: Height and width of the picture.
        frame: Height and width of a network of fixed size, which the picture is made to fit; None for any size.
        multiple: What both sides are multiples of, if the network takes any size.
        longer_side_px: Longer side of the resized picture, about, if the network takes any size.
    """
    if frame:
        scale = min(frame[0] / size[0], frame[1] / size[1])
        high, wide = (max(1, int(side * scale / CELL_PX)) * CELL_PX for side in size)
        return min(high, frame[0]), min(wide, frame[1])
    step = math.lcm(multiple, CELL_PX)
    scale = longer_side_px / max(size)
    high, wide = (max(1, round(side * scale / step)) * step for side in size)
    return high, wide


def _probabilities(output: Array, path: Path) -> Floats:
    """Return (h', w', 19) probabilities of the classes from what a graph gives.

    Args:
        output: (1, 19, h', w') or (1, 20, h', w') scores or probabilities, the twentieth of background, which is
            left out; or (1, h', w') or (1, 1, h', w') numbers of the class of each pixel, any other number none.
        path: File of the graph, for messages.

    Raises:
        BadInput: It gives something else.
    """
    shape = output.shape
    if len(shape) == 4 and shape[0] == 1 and shape[1] in (CLASSES, CLASSES + 1):
        scores = np.asarray(output[0, :CLASSES], dtype=np.float32).transpose(1, 2, 0)
        if (
            output.min() >= 0 and np.abs(output.sum(axis=1) - 1).max() < 1e-3
        ):  # a softmax is part of the graph
            total = scores.sum(axis=-1, keepdims=True)
            return np.where(total > 0, scores / np.where(total > 0, total, 1), np.float32(1 / CLASSES))
        exponential = np.exp(scores - scores.max(axis=-1, keepdims=True))
        return np.asarray(exponential / exponential.sum(axis=-1, keepdims=True))
    if (len(shape) == 3 and shape[0] == 1) or (len(shape) == 4 and shape[:2] == (1, 1)):
        number = output.reshape(shape[-2:])
        known = (number >= 0) & (number < CLASSES)
        one_hot = np.eye(CLASSES, dtype=np.float32)[np.where(known, number, 0).astype(np.int64)]
        return np.where(known[..., None], one_hot, np.float32(1 / CLASSES))
    raise BadInput(
        f"{path}: gives shape {shape}, expected (1, {CLASSES}, h', w') or (1, {CLASSES + 1}, h', w') scores of the "
        "classes of Cityscapes, or (1, h', w') numbers of classes"
    )


def _block_means(values: Floats, rows: int, columns: int) -> Floats:
    """Return (h / rows, w / columns, c) means of (h, w, c) values over blocks; what is left over at the end is cut."""
    high, wide = max(1, len(values) // rows), max(1, values.shape[1] // columns)
    rows, columns = min(rows, len(values)), min(columns, values.shape[1])
    blocks = values[: high * rows, : wide * columns].reshape(high, rows, wide, columns, -1)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)
