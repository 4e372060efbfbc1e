"""Any model that can be written as two ONNX graphs, for vision-language models that have no adapter here."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput, BadSetting, one_line
from upvl_cli.runtime.parallel import threads
from upvl_cli.types import Array, BackgroundRule, Floats
from upvl_cli.vlm.checkpoint import read_json
from upvl_cli.vlm.mini_text import unit

IMAGE, TEXT, TOKENIZER, CARD = FILES = ("image.onnx", "text.onnx", "tokenizer.json", "model.json")
FLOAT, INTEGER = "tensor(float)", "tensor(int64)"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_triple(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))


# Keys of model.json: what each has to be, and whether a value is that.
KEYS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "mean": ("3 numbers, of pixels from 0 to 1", _is_triple),
    "std": ("3 positive numbers", lambda value: _is_triple(value) and min(value) > 0),
    "multiple": ("a whole number from 1 on", lambda value: _is_integer(value) and value > 0),
    "context": ("a whole number from 1 on", lambda value: _is_integer(value) and value > 0),
    "pad_id": ("a whole number from 0 on", lambda value: _is_integer(value) and value >= 0),
    "against": (
        "a list of words",
        lambda value: isinstance(value, list) and all(isinstance(word, str) for word in value),
    ),
    "threshold": ("a number", _is_number),
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


def read_card(path: Path) -> dict[str, Any]:
    """Return the values of model.json; see `KEYS`.

    Raises:
        BadInput: A key is unknown, missing or of another kind; all of them are named.
    """
    content = read_json(path)
    problems = [f"unknown key {key!r}" for key in content if key not in KEYS]
    problems += [f"{key!r} is missing" for key in KEYS if key not in content]
    problems += [
        f"{key!r} is {content[key]!r}, expected {expected}"
        for key, (expected, fits) in KEYS.items()
        if key in content and not fits(content[key])
    ]
    if problems:
        raise BadInput(f"{path}: {'; '.join(problems)} (known keys: {', '.join(KEYS)})")
    return content


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
        self._card = read_card(self._folder / CARD)

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
        return _session(self._folder / TEXT, INTEGER)

    @cached_property
    def _image(self) -> Any:
        return _session(self._folder / IMAGE, FLOAT)


def _session(path: Path, expected: str) -> Any:
    """Load a graph, ready to run.

    Args:
        path: File of the graph.
        expected: Type of its only input.

    Raises:
        BadSetting: onnxruntime is not installed.
        BadInput: The file is no such graph.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise BadSetting(f"{path}: running it needs onnxruntime; pip install 'upvl[onnx]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads()
    wanted = ("CUDAExecutionProvider", "CPUExecutionProvider")
    providers = [name for name in wanted if name in onnxruntime.get_available_providers()]
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # onnxruntime's many errors have no class in common
        raise BadInput(f"{path}: onnxruntime cannot read it ({one_line(error)})") from error
    types = [argument.type for argument in session.get_inputs()]
    if types != [expected] or len(session.get_outputs()) != 1:
        raise BadInput(
            f"{path}: has inputs {types} and {len(session.get_outputs())} outputs, "
            f"expected one input {expected} and one output"
        )
    return session


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
    try:
        (output,) = session.run(None, {session.get_inputs()[0].name: values})
    except Exception as error:
        raise BadInput(f"{path}: cannot take an input of shape {values.shape} ({one_line(error)})") from error
    if output.ndim != axes:
        raise BadInput(f"{path}: gives shape {output.shape}, expected {axes} axes")
    return np.asarray(output, dtype=np.float32)
