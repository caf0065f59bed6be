"""Latent diffusion written out in plain torch with the original's key names, at any size: what the converter is held to.

Architecture after Rombach et al. (CVPR 2022) and Radford et al. (ICML 2021) as the release instantiates it. Only the names
of modules matter beyond the mathematics: `state_dict()` of :class:`LatentDiffusion` is the layout of the release.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

BETA_START, BETA_END = 0.00085, 0.012


def attend(query: Tensor, key: Tensor, value: Tensor, heads: int) -> Tensor:
    """Softmax attention of (N, tokens, width) with the width split between heads."""
    split = [x.unflatten(-1, (heads, -1)).transpose(1, 2) for x in (query, key, value)]
    scores = split[0] @ split[1].mT / math.sqrt(split[0].shape[-1])
    return (scores.softmax(-1) @ split[2]).transpose(1, 2).flatten(2)


# ---- UNet ------------------------------------------------------------------------------------------------------------


class Residual(nn.Module):
    def __init__(self, channels: int, embedding: int, out: int) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(nn.GroupNorm(32, channels), nn.SiLU(), nn.Conv2d(channels, out, 3, padding=1))
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(embedding, out))
        self.out_layers = nn.Sequential(nn.GroupNorm(32, out), nn.SiLU(), nn.Dropout(0), nn.Conv2d(out, out, 3, padding=1))
        self.skip_connection = nn.Identity() if channels == out else nn.Conv2d(channels, out, 1)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        inner = self.in_layers(x) + self.emb_layers(embedding)[..., None, None]
        return self.skip_connection(x) + self.out_layers(inner)


class Attention(nn.Module):
    def __init__(self, width: int, context: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_q = nn.Linear(width, width, bias=False)
        self.to_k, self.to_v = (nn.Linear(context, width, bias=False) for _ in range(2))
        self.to_out = nn.Sequential(nn.Linear(width, width), nn.Dropout(0))

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        return self.to_out(attend(self.to_q(x), self.to_k(context), self.to_v(context), self.heads))


class Gated(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.proj = nn.Linear(width, 8 * width)

    def forward(self, x: Tensor) -> Tensor:
        value, gate = self.proj(x).chunk(2, -1)
        return value * F.gelu(gate)


class TransformerBlock(nn.Module):
    def __init__(self, width: int, context: int, heads: int) -> None:
        super().__init__()
        self.attn1, self.attn2 = Attention(width, width, heads), Attention(width, context, heads)
        self.norm1, self.norm2, self.norm3 = (nn.LayerNorm(width) for _ in range(3))
        self.ff = nn.Module()
        self.ff.net = nn.Sequential(Gated(width), nn.Dropout(0), nn.Linear(4 * width, width))

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        normed = self.norm1(x)
        x = x + self.attn1(normed, normed)
        x = x + self.attn2(self.norm2(x), context)
        return x + self.ff.net(self.norm3(x))


class SpatialTransformer(nn.Module):
    def __init__(self, channels: int, context: int, heads: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(32, channels, eps=1e-6)
        self.proj_in, self.proj_out = nn.Conv2d(channels, channels, 1), nn.Conv2d(channels, channels, 1)
        self.transformer_blocks = nn.ModuleList([TransformerBlock(channels, context, heads)])

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        inner = self.proj_in(self.norm(x))
        tokens = inner.flatten(2).mT
        for block in self.transformer_blocks:
            tokens = block(tokens, context)
        return x + self.proj_out(tokens.mT.unflatten(-1, inner.shape[2:]))


class Down(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.op = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return self.op(x)


class Up(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return self.conv(F.interpolate(x, scale_factor=2))


class UNet(nn.Module):
    def __init__(
        self, width: int, multipliers: Sequence[int], layers: int, attention: Sequence[bool], context: int, heads: int = 8
    ) -> None:
        super().__init__()
        self.width = width
        embedding, levels = 4 * width, len(multipliers)
        self.time_embed = nn.Sequential(nn.Linear(width, embedding), nn.SiLU(), nn.Linear(embedding, embedding))
        self.input_blocks = nn.ModuleList([nn.ModuleList([nn.Conv2d(8, width, 3, padding=1)])])
        skips, channels = [width], width
        for level in range(levels):
            for _ in range(layers):
                block = [Residual(channels, embedding, multipliers[level] * width)]
                channels = multipliers[level] * width
                block += [SpatialTransformer(channels, context, heads)] if attention[level] else []
                self.input_blocks.append(nn.ModuleList(block))
                skips.append(channels)
            if level < levels - 1:
                self.input_blocks.append(nn.ModuleList([Down(channels)]))
                skips.append(channels)
        self.middle_block = nn.ModuleList(
            [
                Residual(channels, embedding, channels),
                SpatialTransformer(channels, context, heads),
                Residual(channels, embedding, channels),
            ]
        )
        self.output_blocks = nn.ModuleList()
        for level in reversed(range(levels)):
            for layer in range(layers + 1):
                block = [Residual(channels + skips.pop(), embedding, multipliers[level] * width)]
                channels = multipliers[level] * width
                block += [SpatialTransformer(channels, context, heads)] if attention[level] else []
                block += [Up(channels)] if level and layer == layers else []
                self.output_blocks.append(nn.ModuleList(block))
        self.out = nn.Sequential(nn.GroupNorm(32, channels), nn.SiLU(), nn.Conv2d(channels, 4, 3, padding=1))

    def forward(self, x: Tensor, steps: Tensor, context: Tensor) -> Tensor:
        half = self.width // 2
        angles = steps[:, None] * torch.exp(-math.log(10000) * torch.arange(half) / half)
        embedding = self.time_embed(torch.cat([angles.cos(), angles.sin()], -1))

        def run(block: nn.ModuleList, x: Tensor) -> Tensor:
            for layer in block:
                match layer:
                    case Residual():
                        x = layer(x, embedding)
                    case SpatialTransformer():
                        x = layer(x, context)
                    case _:
                        x = layer(x)
            return x

        kept = []
        for block in self.input_blocks:
            x = run(block, x)
            kept.append(x)
        x = run(self.middle_block, x)
        for block in self.output_blocks:
            x = run(block, torch.cat([x, kept.pop()], 1))
        return self.out(x)


# ---- autoencoder -----------------------------------------------------------------------------------------------------


class PlainResidual(nn.Module):
    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.norm1, self.norm2 = nn.GroupNorm(32, channels, eps=1e-6), nn.GroupNorm(32, out, eps=1e-6)
        self.conv1, self.conv2 = nn.Conv2d(channels, out, 3, padding=1), nn.Conv2d(out, out, 3, padding=1)
        if channels != out:
            self.nin_shortcut = nn.Conv2d(channels, out, 1)

    def forward(self, x: Tensor) -> Tensor:
        inner = self.conv2(F.silu(self.norm2(self.conv1(F.silu(self.norm1(x))))))
        return inner + (self.nin_shortcut(x) if hasattr(self, "nin_shortcut") else x)


class PlainAttention(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(32, channels, eps=1e-6)
        self.q, self.k, self.v, self.proj_out = (nn.Conv2d(channels, channels, 1) for _ in range(4))

    def forward(self, x: Tensor) -> Tensor:
        normed = self.norm(x)
        query, key, value = (layer(normed).flatten(2).mT for layer in (self.q, self.k, self.v))
        return x + self.proj_out(attend(query, key, value, 1).mT.unflatten(-1, x.shape[2:]))


class Middle(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.block_1, self.attn_1 = PlainResidual(channels, channels), PlainAttention(channels)
        self.block_2 = PlainResidual(channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        return self.block_2(self.attn_1(self.block_1(x)))


class Encoder(nn.Module):
    def __init__(self, width: int, multipliers: Sequence[int], layers: int, latent: int) -> None:
        super().__init__()
        self.conv_in = nn.Conv2d(3, width, 3, padding=1)
        self.down, channels = nn.ModuleList(), width
        for level, multiplier in enumerate(multipliers):
            stage = nn.Module()
            stage.block = nn.ModuleList()
            for _ in range(layers):
                stage.block.append(PlainResidual(channels, multiplier * width))
                channels = multiplier * width
            if level < len(multipliers) - 1:
                stage.downsample = nn.Module()
                stage.downsample.conv = nn.Conv2d(channels, channels, 3, stride=2)
            self.down.append(stage)
        self.mid, self.norm_out = Middle(channels), nn.GroupNorm(32, channels, eps=1e-6)
        self.conv_out = nn.Conv2d(channels, 2 * latent, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        x = self.conv_in(x)
        for stage in self.down:
            for block in stage.block:
                x = block(x)
            if hasattr(stage, "downsample"):
                x = stage.downsample.conv(F.pad(x, (0, 1, 0, 1)))
        return self.conv_out(F.silu(self.norm_out(self.mid(x))))


class Decoder(nn.Module):
    def __init__(self, width: int, multipliers: Sequence[int], layers: int, latent: int) -> None:
        super().__init__()
        channels = multipliers[-1] * width
        self.conv_in, self.mid = nn.Conv2d(latent, channels, 3, padding=1), Middle(channels)
        stages = []
        for level in reversed(range(len(multipliers))):
            stage = nn.Module()
            stage.block = nn.ModuleList()
            for _ in range(layers + 1):
                stage.block.append(PlainResidual(channels, multipliers[level] * width))
                channels = multipliers[level] * width
            if level:
                stage.upsample = Up(channels)
            stages.insert(0, stage)
        self.up = nn.ModuleList(stages)
        self.norm_out, self.conv_out = nn.GroupNorm(32, channels, eps=1e-6), nn.Conv2d(channels, 3, 3, padding=1)

    def forward(self, z: Tensor) -> Tensor:
        x = self.mid(self.conv_in(z))
        for stage in reversed(self.up):
            for block in stage.block:
                x = block(x)
            if hasattr(stage, "upsample"):
                x = stage.upsample(x)
        return self.conv_out(F.silu(self.norm_out(x)))


class Autoencoder(nn.Module):
    def __init__(self, width: int, multipliers: Sequence[int], layers: int, latent: int = 4) -> None:
        super().__init__()
        self.encoder, self.decoder = (kind(width, multipliers, layers, latent) for kind in (Encoder, Decoder))
        self.quant_conv, self.post_quant_conv = nn.Conv2d(2 * latent, 2 * latent, 1), nn.Conv2d(latent, latent, 1)

    def mode(self, x: Tensor) -> Tensor:
        return self.quant_conv(self.encoder(x)).chunk(2, 1)[0]

    def decode(self, z: Tensor) -> Tensor:
        return self.decoder(self.post_quant_conv(z))


# ---- image encoder ---------------------------------------------------------------------------------------------------


class QuickGelu(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x * torch.sigmoid(1.702 * x)


class ClipBlock(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.attn = nn.MultiheadAttention(width, width // 64, batch_first=True)
        self.ln_1, self.ln_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.mlp = nn.Sequential()
        self.mlp.add_module("c_fc", nn.Linear(width, 4 * width))
        self.mlp.add_module("gelu", QuickGelu())
        self.mlp.add_module("c_proj", nn.Linear(4 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        normed = self.ln_1(x)
        x = x + self.attn(normed, normed, normed, need_weights=False)[0]
        return x + self.mlp(self.ln_2(x))


class Visual(nn.Module):
    def __init__(self, width: int, patch: int, side: int, layers: int, out: int) -> None:
        super().__init__()
        self.side = side
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
            model = cls(
                UNet(32, (1, 2), 1, (True, False), 16), Autoencoder(32, (1, 1, 2), 1), Visual(128, 16, 32, 2, 16)
            )
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
