"""Which tensor of a latent-diffusion checkpoint is which parameter of the same network in diffusers or transformers.

One function per network: from a parameter's name in the library to its :class:`Source` in the checkpoint. Going this way
round, every parameter is accounted for: one without a source is an error that names the key.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from torch import Tensor

UNET, UNET_EMA = "model.diffusion_model.", "model_ema.diffusion_model"
VAE, CLIP = "first_stage_model.", "cond_stage_model.model.visual."

_RESNET = {
    "norm1": "in_layers.0",
    "conv1": "in_layers.2",
    "time_emb_proj": "emb_layers.1",
    "norm2": "out_layers.0",
    "conv2": "out_layers.3",
    "conv_shortcut": "skip_connection",
}
_VAE_RESNET = {"conv_shortcut": "nin_shortcut"}
_VAE_ATTENTION = {"group_norm": "norm", "to_q": "q", "to_k": "k", "to_v": "v", "to_out": "proj_out"}
_CLIP_LAYER = {"layer_norm1": "ln_1", "layer_norm2": "ln_2", "mlp.fc1": "mlp.c_fc", "mlp.fc2": "mlp.c_proj"}
_QKV = ("q_proj", "k_proj", "v_proj")


def _whole(tensor: Tensor) -> Tensor:
    return tensor


def _matrix_of_1x1(tensor: Tensor) -> Tensor:
    """A 1 x 1 convolution (out, in, 1, 1) as the linear layer (out, in) that it is."""
    return tensor.flatten(1)


def _transposed(tensor: Tensor) -> Tensor:
    return tensor.T


def _third(number: int) -> Callable[[Tensor], Tensor]:
    """Query, key or value of a projection that stacks the three along its first axis."""
    return lambda tensor: tensor.tensor_split(3)[number]


class Source(NamedTuple):
    """``take(checkpoint[key])`` is the parameter."""

    key: str
    take: Callable[[Tensor], Tensor] = _whole


def ema(key: str) -> str:
    """Key of the moving average of a UNet's parameter: a buffer's name can hold no dots, so they were left out."""
    return UNET_EMA + key.removeprefix(UNET).replace(".", "")


def unet_source(name: str, layers: int, attention: Sequence[bool]) -> Source:
    """Raw (not averaged) source of a parameter of UNet2DConditionModel; :func:`ema` turns its key into the average's.

    ``layers``: residual blocks per level going down. ``attention``: whether each level going up has attention. The
    checkpoint numbers its blocks through: the stem, then ``layers`` blocks and one reduction per level.
    """
    stride = layers + 1
    match name.split("."):
        case ["time_embedding", linear, kind]:
            key = f"time_embed.{ {'linear_1': 0, 'linear_2': 2}[linear] }.{kind}"
        case ["conv_in", kind]:
            key = f"input_blocks.0.0.{kind}"
        case ["conv_norm_out", kind]:
            key = f"out.0.{kind}"
        case ["conv_out", kind]:
            key = f"out.2.{kind}"
        case ["down_blocks", level, "resnets", layer, part, kind]:
            key = f"input_blocks.{1 + int(level) * stride + int(layer)}.0.{_RESNET[part]}.{kind}"
        case ["down_blocks", level, "attentions", layer, *rest]:
            key = f"input_blocks.{1 + int(level) * stride + int(layer)}.1.{'.'.join(rest)}"
        case ["down_blocks", level, "downsamplers", "0", "conv", kind]:
            key = f"input_blocks.{(int(level) + 1) * stride}.0.op.{kind}"
        case ["mid_block", "resnets", layer, part, kind]:
            key = f"middle_block.{2 * int(layer)}.{_RESNET[part]}.{kind}"
        case ["mid_block", "attentions", "0", *rest]:
            key = f"middle_block.1.{'.'.join(rest)}"
        case ["up_blocks", level, "resnets", layer, part, kind]:
            key = f"output_blocks.{int(level) * stride + int(layer)}.0.{_RESNET[part]}.{kind}"
        case ["up_blocks", level, "attentions", layer, *rest]:
            key = f"output_blocks.{int(level) * stride + int(layer)}.1.{'.'.join(rest)}"
        case ["up_blocks", level, "upsamplers", "0", "conv", kind]:
            place = 2 if attention[int(level)] else 1  # after the residual block, and the attention if there is one
            key = f"output_blocks.{int(level) * stride + layers}.{place}.conv.{kind}"
        case _:
            raise KeyError(name)
    return Source(UNET + key)


def vae_source(name: str, levels: int) -> Source:
    """Source of a parameter of AutoencoderKL with ``levels`` resolutions; the checkpoint counts those from fine to coarse."""
    take: Callable[[Tensor], Tensor] = _whole
    match name.split("."):
        case ["quant_conv" | "post_quant_conv", _]:
            key = name
        case [side, "conv_in" | "conv_out" as part, kind]:
            key = f"{side}.{part}.{kind}"
        case [side, "conv_norm_out", kind]:
            key = f"{side}.norm_out.{kind}"
        case ["encoder", "down_blocks", level, "resnets", layer, part, kind]:
            key = f"encoder.down.{level}.block.{layer}.{_VAE_RESNET.get(part, part)}.{kind}"
        case ["encoder", "down_blocks", level, "downsamplers", "0", "conv", kind]:
            key = f"encoder.down.{level}.downsample.conv.{kind}"
        case ["decoder", "up_blocks", level, "resnets", layer, part, kind]:
            key = f"decoder.up.{levels - 1 - int(level)}.block.{layer}.{_VAE_RESNET.get(part, part)}.{kind}"
        case ["decoder", "up_blocks", level, "upsamplers", "0", "conv", kind]:
            key = f"decoder.up.{levels - 1 - int(level)}.upsample.conv.{kind}"
        case [side, "mid_block", "resnets", layer, part, kind]:
            key = f"{side}.mid.block_{int(layer) + 1}.{_VAE_RESNET.get(part, part)}.{kind}"
        case [side, "mid_block", "attentions", "0", part, *_, kind]:
            key = f"{side}.mid.attn_1.{_VAE_ATTENTION[part]}.{kind}"
            take = _matrix_of_1x1 if kind == "weight" and part != "group_norm" else _whole
        case _:
            raise KeyError(name)
    return Source(VAE + key, take)


def clip_source(name: str) -> Source:
    """Source of a parameter of CLIPVisionModelWithProjection in OpenAI's layout."""
    take: Callable[[Tensor], Tensor] = _whole
    match name.removeprefix("vision_model.").split("."):
        case ["visual_projection", "weight"]:
            key, take = "proj", _transposed
        case ["embeddings", "class_embedding"]:
            key = "class_embedding"
        case ["embeddings", "patch_embedding", "weight"]:
            key = "conv1.weight"
        case ["embeddings", "position_embedding", "weight"]:
            key = "positional_embedding"
        case ["pre_layrnorm", kind]:  # so spelled in transformers
            key = f"ln_pre.{kind}"
        case ["post_layernorm", kind]:
            key = f"ln_post.{kind}"
        case ["encoder", "layers", layer, "self_attn", "out_proj", kind]:
            key = f"transformer.resblocks.{layer}.attn.out_proj.{kind}"
        case ["encoder", "layers", layer, "self_attn", projection, kind]:
            key = f"transformer.resblocks.{layer}.attn.in_proj_{kind}"
            take = _third(_QKV.index(projection))
        case ["encoder", "layers", layer, *part, kind]:
            key = f"transformer.resblocks.{layer}.{_CLIP_LAYER['.'.join(part)]}.{kind}"
        case _:
            raise KeyError(name)
    return Source(CLIP + key, take)
