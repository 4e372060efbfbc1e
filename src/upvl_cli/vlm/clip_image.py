"""Dense features of CLIP or SigLIP in one window: a vector of each patch, in the space of the words.

Both pool by attention: the picture's vector is a weighted mean of the values of its patches. The values are
therefore features of the patches in the same space (C. Zhou et al., "Extract Free Dense
Labels from CLIP", ECCV 2022: MaskCLIP). Residual and MLP of the last block are left out: they carry
what is alike everywhere (M. Lan et al., "ClearCLIP", ECCV 2024).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from upvl_cli.vlm import checkpoint

if TYPE_CHECKING:
    from torch import Tensor


class ClipImage:
    """The vision tower, with its last block reduced to the value path.

    Attributes:
        patch: Side of a patch in pixels.
        cells: Patches along the side of the window that the tower was trained on.
        device: Where it runs.
    """

    def __init__(self, folder: Path) -> None:
        """Load the tower.

        Args:
            folder: A checkpoint of CLIP or SigLIP.
        """
        with checkpoint.transformers_errors(folder):
            from transformers import CLIPVisionModelWithProjection, SiglipVisionModel

        full = checkpoint.config(folder)
        self._siglip = full.model_type == "siglip"
        config = full.vision_config
        if self._siglip:
            self._vision = checkpoint.load_tower(SiglipVisionModel, folder, config)
        else:
            config.projection_dim = full.projection_dim
            tower = checkpoint.load_tower(CLIPVisionModelWithProjection, folder, config)
            self._vision, self._projection = tower.vision_model, tower.visual_projection
        self.patch = int(config.patch_size)
        self.cells = int(config.image_size) // self.patch
        self.device = self._vision.device
        layers = self._vision.encoder.layers
        self._last = layers[-1]
        self._vision.encoder.layers = layers[:-1]

    def features(self, windows: Tensor) -> Tensor:
        """Return (b, cells, cells, d) features of windows.

        Args:
            windows: (b, 3, cells * patch, cells * patch) normalised pixels.
        """
        tokens = self.before_last(windows)
        attention = self._last.self_attn
        values = attention.out_proj(attention.v_proj(self._last.layer_norm1(tokens)))
        values = self._vision.post_layernorm(values)
        features: Tensor = self._head_values(values) if self._siglip else self._projection(values[:, 1:])
        return features.reshape(len(windows), self.cells, self.cells, -1)

    def before_last(self, windows: Tensor) -> Tensor:
        """Return (b, tokens, width) inputs of the last block; CLIP's first token is of the whole picture."""
        tokens = self._vision.embeddings(windows)
        if not self._siglip:
            tokens = self._vision.pre_layrnorm(tokens)
        hidden: Tensor = self._vision.encoder(inputs_embeds=tokens).last_hidden_state
        return hidden

    def _head_values(self, tokens: Tensor) -> Tensor:
        """Return (b, patches, d) outputs of SigLIP's pooling head if it attended to one patch only."""
        from torch.nn import functional

        head = self._vision.head
        weight, bias = head.attention.in_proj_weight, head.attention.in_proj_bias
        width = tokens.shape[-1]  # queries, keys and values are projected by one matrix, in this order
        values: Tensor = head.attention.out_proj(
            functional.linear(tokens, weight[2 * width :], bias[2 * width :])
        )
        mixed: Tensor = values + head.mlp(head.layernorm(values))
        return mixed
