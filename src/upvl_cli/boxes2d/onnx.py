"""A detector with the head of YOLOX in an ONNX graph: a file of the user."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from upvl_cli.boxes2d.base import CameraPicture
from upvl_cli.boxes2d.coco import COCO_NAMES
from upvl_cli.boxes2d.config import SuppressionConfig
from upvl_cli.boxes2d.yolox import (
    STRIDES,
    Tile,
    cell_count,
    decode,
    edges_of_centers,
    is_cut,
    suppress,
    tiles,
    to_picture,
)
from upvl_cli.errors import BadInput, one_line
from upvl_cli.runtime.onnx_graph import load_graph, run_graph
from upvl_cli.types import Array, Boxes2d, Floats

_KEYS = ("names", "decoded")
_MIN_SCORE = 0.05  # below this boxes are noise, and there are thousands of them


def files(path: str) -> tuple[Path, ...]:
    """Return the graph, and what stands beside it: its card and weights that exporters split off.

    Raises:
        BadInput: There is no such file.
    """
    graph = Path(path).expanduser()
    if not path or not graph.is_file():
        raise BadInput(f'boxes2d.toml: detector = "onnx:{path}": expected the file of an ONNX graph')
    beside = [_card_path(graph), graph.with_name(f"{graph.name}.data")]
    return (graph, *(each for each in beside if each.is_file()))


def _card_path(graph: Path) -> Path:
    return graph.with_suffix(".toml")


def read_card(path: Path) -> tuple[tuple[str, ...], bool]:
    """Return the names of the kinds, and whether the graph gives boxes in pixels; without a file those of COCO.

    Raises:
        BadInput: The file is no TOML, or a key is unknown or of another kind.
    """
    if not path.is_file():
        return COCO_NAMES, False
    try:
        card = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise BadInput(f"{path}: cannot be read as TOML ({one_line(error)})") from error
    names, decoded = card.get("names", list(COCO_NAMES)), card.get("decoded", False)
    problems = [f"unknown key {key!r}" for key in card if key not in _KEYS]
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        problems.append(f"'names' is {names!r}, expected a list of words, one a kind")
    if not isinstance(decoded, bool):
        problems.append(f"'decoded' is {decoded!r}, expected true or false")
    if problems:
        raise BadInput(f"{path}: {'; '.join(problems)} (known keys: {', '.join(_KEYS)})")
    return tuple(names), decoded


class YoloxDetector:
    """A graph with the head of YOLOX (a `BoxSource2d`)."""

    dropped: Mapping[str, int] = MappingProxyType({})

    def __init__(self, path: str, config: SuppressionConfig) -> None:
        """Read the card; the graph waits for the first picture.

        Args:
            path: File of the graph; `NAME.toml` beside it can name its kinds.
            config: Where it looks, and which boxes stay.
        """
        self._path = files(path)[0]
        self._config = config
        self.names, self._decoded = read_card(_card_path(self._path))

    def boxes(self, picture: CameraPicture) -> Boxes2d:
        """Return the boxes of a picture, best first."""
        height_px, width_px, _ = picture.rgb.shape
        found = [
            self._tile_boxes(tile)
            for tile in tiles(
                picture.rgb, *self._size_px, self._config.tile_scales, self._config.tile_overlap
            )
        ]
        edges, score, kind = (np.concatenate(parts) for parts in zip(*found, strict=True))
        edges = np.clip(edges, 0, [width_px, height_px, width_px, height_px])
        has_area = (edges[:, 2:] > edges[:, :2]).all(axis=1)
        edges, score, kind = edges[has_area], score[has_area], kind[has_area]
        kept = suppress(edges, score, kind, self._config.max_iou)
        # Pixels count from the centre of the first one, which is half a pixel from the corner.
        return Boxes2d(edges[kept] - 0.5, score[kept], np.array(self.names)[kind[kept]])

    def _tile_boxes(self, tile: Tile) -> tuple[Floats, Floats, Array]:
        """Return edges in the picture, score and kind of what is found in a tile."""
        output = self._run(tile.pixels)
        scores = output[:, 4:5] * output[:, 5:]
        kind = scores.argmax(axis=1)
        score = scores[np.arange(len(scores)), kind].astype(np.float64)
        likely = np.flatnonzero(score >= _MIN_SCORE)
        edges = edges_of_centers(output) if self._decoded else decode(output, *self._size_px)
        edges = edges[likely]
        kept = ~is_cut(edges, tile)
        return to_picture(edges[kept], tile), score[likely][kept], kind[likely][kept]

    def _run(self, pixels: Array) -> Floats:
        """Return (c, 5 + k) float32 numbers of each cell."""
        output = run_graph(self._session, self._path, pixels[None])
        expected = (1, cell_count(*self._size_px), 5 + len(self.names))
        if output.shape != expected:
            raise BadInput(
                f"{self._path}: gives shape {output.shape}, expected {expected}: a row for each cell of strides "
                f"{', '.join(map(str, STRIDES))} with 4 numbers of the box, an objectness and a score for each of "
                f"{len(self.names)} kinds (name yours in {_card_path(self._path).name})"
            )
        if not np.isfinite(output).all():
            raise BadInput(f"{self._path}: gives numbers that are not finite; the graph is damaged")
        return np.asarray(output[0], dtype=np.float32)

    @property
    def _size_px(self) -> tuple[int, int]:
        """Height and width of the input."""
        shape = self._session.get_inputs()[0].shape
        return int(shape[2]), int(shape[3])

    @cached_property
    def _session(self) -> Any:
        session = load_graph(self._path, 1)  # frames are worked on side by side
        inputs = [(argument.type, argument.shape) for argument in session.get_inputs()]
        fits = (
            len(inputs) == 1
            and inputs[0][0] == "tensor(float)"
            and len(inputs[0][1]) == 4
            and inputs[0][1][1] == 3
            and all(isinstance(side, int) and side > 0 and side % 32 == 0 for side in inputs[0][1][2:])
        )
        if not fits or len(session.get_outputs()) != 1:
            raise BadInput(
                f"{self._path}: has inputs {inputs} and {len(session.get_outputs())} outputs, expected one input "
                "tensor(float) of shape (1, 3, height, width) with fixed sides that are multiples of 32, and one output"
            )
        return session
