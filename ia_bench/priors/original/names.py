"""Which tensor of a latent-diffusion checkpoint is which parameter of the same network in diffusers or transformers.

For UNet and autoencoder diffusers knows it: its conversions move keys about here instead of tensors, so that nothing is read
before it is used. Every parameter is accounted for: one without a source is an error that names it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from torch import Tensor

from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.original.checkpoint import Checkpoint

UNET, UNET_EMA = "model.diffusion_model.", "model_ema.diffusion_model"
VAE, CLIP = "first_stage_model.", "cond_stage_model.model.visual."

_CLIP_LAYER = {"layer_norm1": "ln_1", "layer_norm2": "ln_2", "mlp.fc1": "mlp.c_fc", "mlp.fc2": "mlp.c_proj"}
_QKV = ("q_proj", "k_proj", "v_proj")


def _whole(tensor: Tensor) -> Tensor:
    return tensor


def _matrix_of_1x1(tensor: Tensor) -> Tensor:
    """A 1 x 1 convolution (out, in, 1, 1) as the linear layer (out, in) that it is; biases and norms as they are."""
    return tensor.flatten(1) if tensor.ndim == 4 else tensor


def _transposed(tensor: Tensor) -> Tensor:
    return tensor.T


def _third(number: int) -> Callable[[Tensor], Tensor]:
    """Query, key or value of a projection that stacks the three along its first axis."""
    return lambda tensor: tensor.tensor_split(3)[number]


class Source(NamedTuple):
    """``take(checkpoint[key])`` is the parameter."""

    key: str
    take: Callable[[Tensor], Tensor] = _whole


class _Key(str):
    """What a conversion moves about in place of a tensor; it asks a tensor for nothing but its axes."""

    __slots__ = ()
    ndim, shape = 0, ()


def unet_sources(checkpoint: Checkpoint, config: Mapping[str, Any]) -> dict[str, Source]:
    """Parameter of UNet2DConditionModel -> its moving average. A buffer's name can hold no dots, so they were left out of it."""
    import_torchvision()
    from diffusers.loaders.single_file_utils import convert_ldm_unet_checkpoint

    raw = convert_ldm_unet_checkpoint({key: _Key(key) for key in checkpoint if key.startswith(UNET)}, config)
    return {name: Source(UNET_EMA + key.removeprefix(UNET).replace(".", "")) for name, key in raw.items()}


def vae_sources(checkpoint: Checkpoint, config: Mapping[str, Any]) -> dict[str, Source]:
    """Parameter of AutoencoderKL -> its source."""
    import_torchvision()
    from diffusers.loaders.single_file_utils import convert_ldm_vae_checkpoint

    raw = convert_ldm_vae_checkpoint({key: _Key(key) for key in checkpoint if key.startswith(VAE)}, config)
    return {name: Source(str(key), _matrix_of_1x1 if ".attentions." in name else _whole) for name, key in raw.items()}


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
