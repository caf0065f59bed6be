"""The networks' hyper-parameters, read from the shapes of a checkpoint, as configurations of diffusers and transformers.

What shapes cannot tell is the same in all of Stable Diffusion 1 and in the release: see the constants.
"""

from __future__ import annotations

from typing import Any

import torch

from ia_bench.common.errors import InputError
from ia_bench.priors.original.checkpoint import Checkpoint
from ia_bench.priors.original.names import CLIP, UNET, VAE

RESOLUTION = 256
"""Side in pixels of the images that the release was trained on."""

UNET_HEADS = 8
CLIP_HEAD_WIDTH = 64
LATENT_SCALE = 0.18215
"""Latents are multiplied by this before noise is added: it brings their standard deviation near 1."""

BETA_START, BETA_END = 0.00085, 0.012
"""Variances of the first and last noising step; their square roots are evenly spaced between."""


def unet_config(checkpoint: Checkpoint, latent_side: int) -> dict[str, Any]:
    """Configuration of UNet2DConditionModel for latents of ``latent_side`` x ``latent_side``."""
    blocks = _count(checkpoint, f"{UNET}input_blocks.")
    reductions = [i for i in range(blocks) if f"{UNET}input_blocks.{i}.0.op.weight" in checkpoint]
    stride = reductions[0] if reductions else blocks  # residual blocks of a level, and its reduction
    first_blocks = [f"{UNET}input_blocks.{1 + level * stride}" for level in range(len(reductions) + 1)]
    attention = [f"{first}.1.norm.weight" in checkpoint for first in first_blocks]
    return {
        "sample_size": latent_side,
        "in_channels": checkpoint.size(f"{UNET}input_blocks.0.0.weight", 1),
        "out_channels": checkpoint.size(f"{UNET}out.2.weight", 0),
        "block_out_channels": [checkpoint.size(f"{first}.0.out_layers.3.weight", 0) for first in first_blocks],
        "layers_per_block": stride - 1,
        "down_block_types": ["CrossAttnDownBlock2D" if has else "DownBlock2D" for has in attention],
        "up_block_types": ["CrossAttnUpBlock2D" if has else "UpBlock2D" for has in reversed(attention)],
        "cross_attention_dim": checkpoint.size(f"{UNET}middle_block.1.transformer_blocks.0.attn2.to_k.weight", 1),
        "attention_head_dim": UNET_HEADS,  # diffusers' name for the number of heads
    }


def vae_config(checkpoint: Checkpoint, resolution: int) -> dict[str, Any]:
    """Configuration of AutoencoderKL."""
    levels = _count(checkpoint, f"{VAE}encoder.down.")
    return {
        "sample_size": resolution,
        "in_channels": checkpoint.size(f"{VAE}encoder.conv_in.weight", 1),
        "out_channels": checkpoint.size(f"{VAE}decoder.conv_out.weight", 0),
        "block_out_channels": [checkpoint.size(f"{VAE}encoder.down.{i}.block.0.conv1.weight", 0) for i in range(levels)],
        "layers_per_block": _count(checkpoint, f"{VAE}encoder.down.0.block."),
        "down_block_types": ["DownEncoderBlock2D"] * levels,
        "up_block_types": ["UpDecoderBlock2D"] * levels,
        "latent_channels": checkpoint.size(f"{VAE}quant_conv.weight", 0) // 2,  # mean and log variance
        "scaling_factor": LATENT_SCALE,
    }


def clip_config(checkpoint: Checkpoint) -> dict[str, Any]:
    """Configuration of CLIPVisionModelWithProjection."""
    width, patch = (checkpoint.size(f"{CLIP}conv1.weight", axis) for axis in (0, 2))
    patches = checkpoint.size(f"{CLIP}positional_embedding", 0) - 1  # one token is the class
    return {
        "hidden_size": width,
        "intermediate_size": checkpoint.size(f"{CLIP}transformer.resblocks.0.mlp.c_fc.weight", 0),
        "num_hidden_layers": _count(checkpoint, f"{CLIP}transformer.resblocks."),
        "num_attention_heads": max(width // CLIP_HEAD_WIDTH, 1),
        "image_size": patch * round(patches**0.5),
        "patch_size": patch,
        "projection_dim": checkpoint.size(f"{CLIP}proj", 1),
        "hidden_act": "quick_gelu",
    }


def scheduler_config(checkpoint: Checkpoint) -> dict[str, Any]:
    """Configuration of DDIMScheduler as the release samples. Raises InputError if the checkpoint had another schedule."""
    betas = checkpoint.tensor("betas")
    expected = torch.linspace(BETA_START**0.5, BETA_END**0.5, len(betas), dtype=torch.float64) ** 2
    error = float((betas.double() - expected).abs().max())
    if not error <= 1e-6:
        raise InputError(
            f"{checkpoint.path}: betas: expected {len(betas)} values from {BETA_START} to {BETA_END} with evenly spaced "
            f"square roots, found values that differ by up to {error:.2g}"
        )
    return {
        "num_train_timesteps": len(betas),
        "beta_start": BETA_START,
        "beta_end": BETA_END,
        "beta_schedule": "scaled_linear",
        "prediction_type": "epsilon",
        "clip_sample": False,
        "set_alpha_to_one": False,
        "steps_offset": 1,
        "timestep_spacing": "leading",
    }


def _count(checkpoint: Checkpoint, prefix: str) -> int:
    """How many numbers follow ``prefix`` in the checkpoint's keys. Raises InputError if none does."""
    numbers = {key.removeprefix(prefix).partition(".")[0] for key in checkpoint if key.startswith(prefix)}
    if not numbers:
        raise InputError(f"{checkpoint.path}: expected tensors {prefix}0..., found none")
    return len(numbers)
