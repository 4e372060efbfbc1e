"""Vision-language models: pictures and words in one space. A model loads its libraries when it is opened."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import TYPE_CHECKING

from upvl_cli.errors import BadSetting
from upvl_cli.vlm.base import ModelFamily

if TYPE_CHECKING:
    from upvl_cli.types import Model


def _mini_files(weights: str) -> tuple[Path, ...]:
    from upvl_cli.vlm.mini import files

    return files(weights)


def _mini(weights: str) -> Model:
    from upvl_cli.vlm.mini import Mini

    return Mini()


def _clip_files(weights: str) -> tuple[Path, ...]:
    from upvl_cli.vlm.clip import files

    return files(weights)


def _clip(weights: str) -> Model:
    from upvl_cli.vlm.clip import Clip

    return Clip(weights)


def _siglip_files(weights: str) -> tuple[Path, ...]:
    from upvl_cli.vlm.siglip import files

    return files(weights)


def _siglip(weights: str) -> Model:
    from upvl_cli.vlm.siglip import Siglip

    return Siglip(weights)


def _openseg_files(weights: str) -> tuple[Path, ...]:
    from upvl_cli.vlm.openseg import files

    return files(weights)


def _openseg(weights: str) -> Model:
    from upvl_cli.vlm.openseg import OpenSeg

    return OpenSeg(weights)


def _onnx_files(weights: str) -> tuple[Path, ...]:
    from upvl_cli.vlm.onnx import files

    return files(weights)


def _onnx(weights: str) -> Model:
    from upvl_cli.vlm.onnx import Onnx

    return Onnx(weights)


def _cityscapes_files(weights: str) -> tuple[Path, ...]:
    from upvl_cli.vlm.cityscapes import files

    return files(weights)


def _cityscapes(weights: str) -> Model:
    from upvl_cli.vlm.cityscapes import Cityscapes

    return Cityscapes(weights)


MODELS: dict[str, ModelFamily] = {
    "mini": ModelFamily(_mini_files, _mini, "mini", version=3),
    "clip": ModelFamily(_clip_files, _clip, "clip:/models/clip-vit-base-patch16"),
    "siglip": ModelFamily(_siglip_files, _siglip, "siglip:/models/siglip-base-patch16-384"),
    "openseg": ModelFamily(_openseg_files, _openseg, "openseg:/models/openseg"),
    "onnx": ModelFamily(_onnx_files, _onnx, "onnx:/models/mine"),
    "cityscapes": ModelFamily(_cityscapes_files, _cityscapes, "cityscapes:/models/street.onnx"),
}


def model_family(model: str) -> tuple[ModelFamily, str]:
    """Return the model family that a value such as "clip:/models/b16" names, and what follows its colon.

    Raises:
        BadSetting: No family has that name.
    """
    name, _, weights = model.partition(":")
    if name not in MODELS:
        close = difflib.get_close_matches(name, MODELS, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        known = ", ".join(repr(family.example) for family in MODELS.values())
        raise BadSetting(f"vlm.toml: model = {model!r}: unknown model {name!r}{hint} (for example: {known})")
    return MODELS[name], weights
