"""OpenSeg (G. Ghiasi et al., ECCV 2022) as its authors exported it: the model of the paper's experiments.

The exported image network is a TensorFlow program that takes an encoded picture; it is used as in OpenScene
(S. Peng et al., CVPR 2023). Its features live in the text space of CLIP ViT-L/14@336px, whose text tower has to
be laid beside it. A SavedModel can do whatever TensorFlow can, read and write files included: take it only
from people you trust.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput, BadSetting, one_line
from upvl_cli.types import Array, BackgroundRule, Floats
from upvl_cli.vlm import checkpoint
from upvl_cli.vlm.clip import NEUTRAL
from upvl_cli.vlm.clip_text import ClipText

SIGNATURE = "serving_default"
TEXT_KINDS = ("clip", "clip_text_model")
REGIONS, PIXELS, INFO = "ppixel_ave_feat", "image_embedding_feat", "image_info"


def files(weights: str) -> tuple[Path, ...]:
    """Return the files that make the model.

    Raises:
        BadInput: The folder is not a SavedModel with a text tower beside it.
    """
    folder = Path(weights).expanduser()
    variables = sorted(folder.glob("variables/variables.*"))
    missing = [] if (folder / "saved_model.pb").is_file() else ["saved_model.pb"]
    missing += [] if variables else ["variables/"]
    missing += [] if (folder / "text").is_dir() else ["text/ (CLIP ViT-L/14@336px, as transformers saves it)"]
    if not weights or missing:
        raise BadInput(
            f'vlm.toml: model = "openseg:{weights}": expected a folder that holds the exported OpenSeg; '
            f"it lacks {', '.join(missing)}"
        )
    return tuple(
        sorted([folder / "saved_model.pb", *variables, *checkpoint.files(folder / "text", TEXT_KINDS)])
    )


class OpenSeg:
    """OpenSeg with the text space of CLIP (a `Model`).

    Attributes:
        background: The paper's own rule, cos >= 0.02, is on the scale of the 640 numbers of its BERT text
            space. Cosines of CLIP have an offset, so here background is compared with neutral words.
    """

    background = BackgroundRule(NEUTRAL, 0.0)

    def __init__(self, weights: str) -> None:
        """Read the configuration; the networks wait for the first word and the first picture.

        Args:
            weights: Folder of the SavedModel, with the text tower in its folder `text`.
        """
        files(weights)
        self.name = f"openseg:{weights}"
        self._folder = Path(weights).expanduser()
        self._text = ClipText(self._folder / "text")

    @property
    def dim(self) -> int:
        """Length of its vectors."""
        return self._text.dim

    def embed_text(self, words: Sequence[str]) -> Floats:
        """Return (t, d) vectors of length 1."""
        return self._text.embed(words)

    def embed_image(self, rgb: Array) -> Floats:
        """Return (h', w', d) features, the longer side 640: means over the regions that OpenSeg proposes.

        A pixel in no region keeps its own feature: the mean over none would be zero.
        """
        network = self._network
        import tensorflow as tf
        from PIL import Image

        encoded = io.BytesIO()
        Image.fromarray(rgb).save(encoded, format="PNG", compress_level=1)
        outputs = network.signatures[SIGNATURE](
            inp_image_bytes=tf.constant(encoded.getvalue()),
            inp_text_emb=tf.zeros([1, 1, self.dim]),  # only its class scores depend on it
        )
        # The picture fills the upper left of a square; rows of `image_info`: its size, the square's, the scale.
        info = outputs[INFO].numpy()
        high, wide = (round(float(side)) for side in info[0] * info[2])
        features = np.array(outputs[REGIONS][0, :high, :wide].numpy(), dtype=np.float32)
        outside = ~features.any(axis=2)
        features[outside] = outputs[PIXELS][0, :high, :wide].numpy()[outside]
        return features

    @cached_property
    def _network(self) -> Any:
        """The exported model."""
        try:
            import tensorflow as tf
        except ImportError as error:
            raise BadSetting(f"{self.name}: needs TensorFlow; pip install 'upvl[openseg]'") from error
        try:
            model = tf.saved_model.load(str(self._folder), tags=["serve"])
            function = model.signatures[SIGNATURE]
        except (OSError, ValueError, KeyError, RuntimeError, tf.errors.OpError) as error:
            raise BadInput(
                f"{self._folder}: cannot be read as a SavedModel with the signature {SIGNATURE} "
                f"({one_line(error)})"
            ) from error
        inputs, outputs = function.structured_input_signature[1], function.structured_outputs
        missing = {"inp_image_bytes", "inp_text_emb"} - set(inputs) | {REGIONS, PIXELS, INFO} - set(outputs)
        if missing:
            raise BadInput(
                f"{self._folder}: its {SIGNATURE} lacks {', '.join(sorted(missing))}; expected OpenSeg's"
            )
        length = inputs["inp_text_emb"].shape[-1]
        if length not in (self.dim, None):  # None: it does not say
            raise BadInput(
                f"{self._folder}: takes words of {length} numbers and text/ gives {self.dim}; "
                "expected the text tower that OpenSeg was trained with, CLIP ViT-L/14@336px"
            )
        return model
