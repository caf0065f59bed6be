"""A checkpoint as the release lays it out, at any size: networks of diffusers under its names, and its image encoder itself.

OpenAI's CLIP (Radford et al., ICML 2021) is written out in plain torch, because the converter translates its names itself.
"""

from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ldm_names import of_unet, of_vae
from torch import Tensor, nn

from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench_training.convert_weights import AVERAGE, CLIP, UNET

Layout = Mapping[str, dict[str, Any]]
TINY: Layout = {  # 32 x 32 images, 8 x 8 latents, attention on the finer level alone; 1.5 M parameters
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


class QuickGelu(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x * torch.sigmoid(1.702 * x)


class ClipBlock(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.attn = nn.MultiheadAttention(width, width // 64, batch_first=True)
        self.ln_1, self.ln_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        layers = {"c_fc": nn.Linear(width, 4 * width), "gelu": QuickGelu(), "c_proj": nn.Linear(4 * width, width)}
        self.mlp = nn.Sequential(OrderedDict(layers))

    def forward(self, x: Tensor) -> Tensor:
        normed = self.ln_1(x)
        x = x + self.attn(normed, normed, normed, need_weights=False)[0]
        return x + self.mlp(self.ln_2(x))


class Visual(nn.Module):
    def __init__(self, width: int, patch: int, side: int, layers: int, out: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, width, patch, stride=patch, bias=False)
        self.class_embedding = nn.Parameter(torch.randn(width))
        self.positional_embedding = nn.Parameter(torch.randn((side // patch) ** 2 + 1, width))
        self.ln_pre, self.ln_post = nn.LayerNorm(width), nn.LayerNorm(width)
        self.transformer = nn.Module()
        self.transformer.resblocks = nn.ModuleList([ClipBlock(width) for _ in range(layers)])
        self.proj = nn.Parameter(torch.randn(width, out) / width**0.5)

    def forward(self, x: Tensor) -> Tensor:
        patches = self.conv1(x).flatten(2).mT
        tokens = torch.cat([self.class_embedding.expand(len(x), 1, -1), patches], 1)
        tokens = self.ln_pre(tokens + self.positional_embedding)
        for block in self.transformer.resblocks:
            tokens = block(tokens)
        return self.ln_post(tokens[:, 0]) @ self.proj


def originals(layout: Layout) -> tuple[Any, Any, Visual]:
    """UNet, autoencoder and image encoder of these sizes, as they are made."""
    import_torchvision()
    from diffusers import AutoencoderKL, UNet2DConditionModel

    sizes = ("hidden_size", "patch_size", "image_size", "num_hidden_layers", "projection_dim")
    visual = Visual(*(layout["image_encoder"][size] for size in sizes))
    return UNet2DConditionModel(**layout["unet"]), AutoencoderKL(**layout["vae"]), visual


def tiny(seed: int) -> tuple[Any, Any, Visual]:
    """Every weight differs from its initial value, norms included, so that a swapped tensor shows."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        networks = originals(TINY)
        for parameter in (parameter for network in networks for parameter in network.parameters()):
            parameter.data += 0.05 * torch.randn_like(parameter)
    for network in networks:
        network.eval().requires_grad_(False)
    return networks


def state_of(unet: Any, vae: Any, visual: Visual) -> dict[str, Tensor]:
    """The tensors of a checkpoint: the UNet is the moving average, whose names have no dots; its raw weights differ everywhere."""
    averages = of_unet(unet.state_dict(), unet.config.layers_per_block)
    return {
        **{UNET + key: value + 0.05 for key, value in averages.items()},
        **{AVERAGE + key.replace(".", ""): value for key, value in averages.items()},
        "model_ema.decay": torch.tensor(0.9999),
        "model_ema.num_updates": torch.tensor(100000),
        **{f"first_stage_model.{key}": value for key, value in of_vae(vae.state_dict()).items()},
        **{CLIP + key: value for key, value in visual.state_dict().items()},
        "betas": torch.linspace(0.00085**0.5, 0.012**0.5, 1000) ** 2,
    }


def lightning(state: Mapping[str, Tensor]) -> dict[str, Any]:
    """The content of `last.ckpt`: the tensors, optimiser, counters."""
    score = {"best_model_score": torch.tensor(0.1), "best": np.float64(0.1), "wait": np.int64(3)}
    return {
        "epoch": 7,
        "global_step": 100000,
        "pytorch-lightning_version": "1.5.2",
        "state_dict": dict(state),
        "callbacks": {"ModelCheckpoint": score},
        "optimizer_states": [{"state": {0: {"step": 1, "exp_avg": torch.zeros(3)}}, "param_groups": [{"lr": 1e-4}]}],
        "lr_schedulers": [{"last_epoch": 7, "_step_count": 8}],
    }


def save(content: Mapping[str, Any], path: Path) -> Path:
    """Write a checkpoint and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(dict(content), path)
    return path
