"""Latent diffusion written out in plain torch with the original's key names, at any size: what the converter is held to.

Architecture after Rombach et al. (CVPR 2022) and Radford et al. (ICML 2021) as the release instantiates it. Only the names
of modules matter beyond the mathematics: `state_dict()` of :class:`LatentDiffusion` is the layout of the release.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ldm_images import Autoencoder, Visual
from ldm_unet import UNet
from torch import Tensor, nn

BETA_START, BETA_END = 0.00085, 0.012
TINY: dict[str, dict[str, Any]] = {
    "unet": {
        "sample_size": 8,
        "in_channels": 8,
        "block_out_channels": [32, 64],
        "layers_per_block": 1,
        "down_block_types": ["CrossAttnDownBlock2D", "DownBlock2D"],
        "up_block_types": ["UpBlock2D", "CrossAttnUpBlock2D"],
        "cross_attention_dim": 16,
        "attention_head_dim": 8,
    },
    "vae": {
        "sample_size": 32,
        "block_out_channels": [32, 32, 64],
        "down_block_types": ["DownEncoderBlock2D"] * 3,
        "up_block_types": ["UpDecoderBlock2D"] * 3,
        "scaling_factor": 0.18215,
    },
    "image_encoder": {
        "hidden_size": 128,
        "intermediate_size": 512,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "image_size": 32,
        "patch_size": 16,
        "projection_dim": 16,
        "hidden_act": "quick_gelu",
    },
}
"""The sizes of :meth:`LatentDiffusion.tiny` in the words of diffusers and transformers."""


# ---- the whole, and its checkpoint -----------------------------------------------------------------------------------
class LatentDiffusion(nn.Module):
    """Every weight differs from its initial value, norms included, so that a swapped tensor shows."""

    def __init__(self, unet: UNet, autoencoder: Autoencoder, visual: Visual) -> None:
        super().__init__()
        self.model, self.cond_stage_model = nn.Module(), nn.Module()
        self.model.diffusion_model = unet
        self.first_stage_model = autoencoder
        self.cond_stage_model.model = nn.Module()
        self.cond_stage_model.model.visual = visual
        self.register_buffer("betas", torch.linspace(BETA_START**0.5, BETA_END**0.5, 1000) ** 2)

    @classmethod
    def tiny(cls, seed: int) -> LatentDiffusion:
        """Two levels, attention on the finer one alone; 32 x 32 images, 8 x 8 latents; 1.5 M parameters."""
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            model = cls(UNet(32, (1, 2), 1, (True, False), 16), Autoencoder(32, (1, 1, 2), 1), Visual(128, 16, 32, 2, 16))
            for parameter in model.parameters():
                parameter.data += 0.05 * torch.randn_like(parameter)
        return model.eval().requires_grad_(False)

    @classmethod
    def full_size(cls) -> LatentDiffusion:
        """The release's size, without memory."""
        with torch.device("meta"):
            return cls(
                UNet(320, (1, 2, 4, 4), 2, (True, True, True, False), 768),
                Autoencoder(128, (1, 2, 4, 4), 2),
                Visual(1024, 14, 224, 24, 768),
            )

    def average(self) -> dict[str, Tensor]:
        """The UNet's weights as their moving average would differ from them: by a little, everywhere."""
        generator = torch.Generator().manual_seed(1)
        raw = self.model.diffusion_model.state_dict()
        return {name: value + 0.05 * torch.randn(value.shape, generator=generator) for name, value in raw.items()}

    def lightning(self) -> dict[str, Any]:
        """The content of `last.ckpt`: raw weights, moving average with the dots left out, optimiser, counters."""
        averages = {f"model_ema.diffusion_model{k.replace('.', '')}": v for k, v in self.average().items()}
        counters = {"model_ema.decay": torch.tensor(0.9999), "model_ema.num_updates": torch.tensor(100000)}
        score = {"best_model_score": torch.tensor(0.1), "best": np.float64(0.1), "wait": np.int64(3)}
        return {
            "epoch": 7,
            "global_step": 100000,
            "pytorch-lightning_version": "1.5.2",
            "state_dict": {**self.state_dict(), **averages, **counters},
            "callbacks": {"ModelCheckpoint": score},
            "optimizer_states": [{"state": {0: {"step": 1, "exp_avg": torch.zeros(3)}}, "param_groups": [{"lr": 1e-4}]}],
            "lr_schedulers": [{"last_epoch": 7, "_step_count": 8}],
        }

    def reference(self) -> LatentDiffusion:
        """A copy with the averaged UNet and every weight rounded to half precision: what the conversion must compute."""
        copy = type(self).tiny(0)
        state = {**self.state_dict(), **{f"model.diffusion_model.{k}": v for k, v in self.average().items()}}
        copy.load_state_dict({k: v if k == "betas" else v.half().float() for k, v in state.items()})
        return copy


def save(content: Mapping[str, Any], path: Path) -> Path:
    """Write a checkpoint and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(dict(content), path)
    return path
