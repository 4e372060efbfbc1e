"""SigLIP or SigLIP 2 from a checkpoint of the user's, with dense features at the resolution of the picture.

X. Zhai et al., "Sigmoid Loss for Language Image Pre-Training" (ICCV 2023), and M. Tschannen et al., "SigLIP 2"
(arXiv 2502.14786). Windows, patches and words are those of `clip`: its picture vector is pooled by an attention head
of its own, whose value path gives the feature of a patch (`ClipImage`), and its words are padded to the length
of its training (`ClipText`).
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from upvl_cli.vlm.clip import Clip


def files(weights: str) -> tuple[Path, ...]:
    """Return the files that make the model.

    Raises:
        BadInput: It is not a checkpoint of SigLIP with safetensors.
    """
    return Siglip.files(Siglip.folder(weights))


class Siglip(Clip):
    """SigLIP or SigLIP 2 (a `Model`)."""

    family: ClassVar[str] = "siglip"
    kinds: ClassVar[tuple[str, ...]] = ("siglip",)
    hints: ClassVar[dict[str, str]] = {
        "clip": 'for CLIP write model = "clip:FOLDER"',
        "siglip2": "that is SigLIP 2 with any number of patches (NaFlex); "
        "take one of a fixed size, such as siglip2-base-patch16-384",
    }
