"""Any model that can be written as two ONNX graphs, for vision-language models that have no adapter here."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput, one_line
from upvl_cli.runtime.onnx_graph import FLOAT, INTEGER, open_graph, run_graph
from upvl_cli.runtime.parallel import threads
from upvl_cli.types import Array, BackgroundRule, Floats
from upvl_cli.vlm.mini_text import unit
from upvl_cli.vlm.model_card import IMAGE_KEYS, CardKeys, is_integer, is_number, is_strings, read_card

IMAGE, TEXT, TOKENIZER, CARD = FILES = ("image.onnx", "text.onnx", "tokenizer.json", "model.json")
KEYS: CardKeys = IMAGE_KEYS | {
    "context": ("a whole number from 1 on", lambda value: is_integer(value) and value > 0),
    "pad_id": ("a whole number from 0 on", lambda value: is_integer(value) and value >= 0),
    "against": ("a list of words", is_strings),
    "threshold": ("a number", is_number),
}


def files(weights: str) -> tuple[Path, ...]:
    """Return the files that make the model.

    Raises:
        BadInput: One of them is missing.
    """
    folder = Path(weights).expanduser()
    missing = [name for name in FILES if not (folder / name).is_file()]
    if not weights or missing:
        raise BadInput(
            f'vlm.toml: model = "onnx:{weights}": expected a folder with {", ".join(FILES)}; '
            f"it lacks {', '.join(missing)}"
        )
    # Exporters lay weights of more than 2 GB beside the graph.
    return tuple(sorted([*(folder / name for name in FILES), *folder.glob("*.data")]))


class Onnx:
    """Two graphs and a tokenizer (a `Model`)."""

    def __init__(self, weights: str) -> None:
        """Read model.json; the graphs wait for the first word and the first picture.

        Args:
            weights: Folder with the files.
        """
        files(weights)
        self.name = f"onnx:{weights}"
        self._folder = Path(weights).expanduser()
        self._card = read_card(self._folder / CARD, KEYS)

    @property
    def background(self) -> BackgroundRule:
        """The rule of model.json."""
        return BackgroundRule(tuple(self._card["against"]), float(self._card["threshold"]))

    @cached_property
    def dim(self) -> int:
        """Length of its vectors: graphs need not declare it, so a word is asked."""
        return int(self.embed_text(["thing"]).shape[1])

    def embed_text(self, words: Sequence[str]) -> Floats:
        """Return (t, d) vectors of length 1."""
        if not words:
            return np.zeros((0, self.dim), dtype=np.float32)
        tokens = np.array(
            [encoding.ids for encoding in self._tokenizer.encode_batch(list(words))], dtype=np.int64
        )
        return unit(_run(self._text, self._folder / TEXT, tokens, 2))

    def embed_image(self, rgb: Array) -> Floats:
        """Return (h', w', d) features, as the graph gives them."""
        from PIL import Image

        multiple = self._card["multiple"]
        high, wide = (max(1, round(side / multiple)) * multiple for side in rgb.shape[:2])
        picture = Image.fromarray(rgb).resize((wide, high), Image.Resampling.BICUBIC)
        mean, std = (np.array(self._card[key], dtype=np.float32) for key in ("mean", "std"))
        pixels = (np.asarray(picture, dtype=np.float32) / 255 - mean) / std
        pixels = np.ascontiguousarray(pixels.transpose(2, 0, 1)[None])
        features = _run(self._image, self._folder / IMAGE, pixels, 4)
        if features.shape[:2] != (1, self.dim):
            raise BadInput(
                f"{self._folder / IMAGE}: gives {features.shape}, expected (1, {self.dim}, h', w'), "
                f"as {TEXT} gives words {self.dim} numbers"
            )
        return np.ascontiguousarray(features[0].transpose(1, 2, 0))

    @cached_property
    def _tokenizer(self) -> Any:
        from tokenizers import Tokenizer

        path = self._folder / TOKENIZER
        try:
            tokenizer = Tokenizer.from_file(str(path))
        except Exception as error:  # the library has no class of its own for this
            raise BadInput(f"{path}: cannot be read as a tokenizer ({one_line(error)})") from error
        tokenizer.enable_truncation(self._card["context"])
        tokenizer.enable_padding(length=self._card["context"], pad_id=self._card["pad_id"])
        return tokenizer

    @cached_property
    def _text(self) -> Any:
        return open_graph(self._folder / TEXT, INTEGER, threads())

    @cached_property
    def _image(self) -> Any:
        return open_graph(self._folder / IMAGE, FLOAT, threads())


def _run(session: Any, path: Path, values: Array, axes: int) -> Floats:
    """Run a graph on an array and return its output as float32.

    Args:
        session: The loaded graph.
        path: File of the graph, for messages.
        values: The only input.
        axes: Number of axes that the output must have.

    Raises:
        BadInput: The graph refuses the input, or gives something else.
    """
    output = run_graph(session, path, values)
    if output.ndim != axes:
        raise BadInput(f"{path}: gives shape {output.shape}, expected {axes} axes")
    return np.asarray(output, dtype=np.float32)
