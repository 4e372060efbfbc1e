"""Words as vectors of CLIP or SigLIP: the half of the model that queries need."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.types import Floats
from upvl_cli.vlm import checkpoint

# How captions speak of a thing; the prompt that CLIP's authors found to suit any class.
PROMPT = "a photo of a {}."
BATCH = 64


class ClipText:
    """The text tower.

    Attributes:
        dim: Length of its vectors, known before the tower is loaded.
    """

    def __init__(self, folder: Path) -> None:
        """Read the configuration; the tower waits for the first word.

        Args:
            folder: A checkpoint of CLIP or SigLIP, or the text tower of CLIP alone.
        """
        self._folder = folder
        full = checkpoint.config(folder)
        self._siglip = full.model_type == "siglip"
        self._config = full if full.model_type == "clip_text_model" else full.text_config
        if full.model_type == "clip":
            # The copy of this number in the tower's own configuration is often left at its default.
            self._config.projection_dim = full.projection_dim
        self.dim = int(self._config.projection_size if self._siglip else self._config.projection_dim)

    def embed(self, words: Sequence[str]) -> Floats:
        """Return (t, d) float32 vectors of length 1, one a word or phrase."""
        parts = [self._vectors(words[start : start + BATCH]) for start in range(0, len(words), BATCH)]
        return np.concatenate([np.zeros((0, self.dim), np.float32), *parts])

    def _vectors(self, words: Sequence[str]) -> Floats:
        import torch
        from torch.nn import functional

        tokens = self._tokenizer(
            # SigLIP 2 was trained on lower case, which its tokenizer does not see to; the others' do.
            [PROMPT.format(word).lower() for word in words],
            # SigLIP reads its vector at the last place, whatever stands there: it was trained on full length.
            padding="max_length" if self._siglip else True,
            padding_side="right",  # as in training; the class of SigLIP 2's tokenizer has the left as its default
            truncation=True,
            max_length=self._config.max_position_embeddings,
            return_tensors="pt",
        )
        with torch.inference_mode():
            # No mask: SigLIP was trained without, and CLIP looks back only, from a place before the padding.
            outputs = self._tower(tokens["input_ids"].to(self._tower.device))
            pooled = outputs.pooler_output if self._siglip else outputs.text_embeds
            return np.asarray(functional.normalize(pooled, dim=-1).cpu().numpy())

    @cached_property
    def _tokenizer(self) -> Any:
        return checkpoint.tokenizer(self._folder)

    @cached_property
    def _tower(self) -> Any:
        with checkpoint.transformers_errors(self._folder):
            from transformers import CLIPTextModelWithProjection, SiglipTextModel

        kind = SiglipTextModel if self._siglip else CLIPTextModelWithProjection
        return checkpoint.load_tower(kind, self._folder, self._config)
