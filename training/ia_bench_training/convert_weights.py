"""``python -m ia_bench_training.convert_weights``: a checkpoint of the original release as weights that the package reads."""

from __future__ import annotations

import hashlib
import json
import pickle
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.serialization import safe_globals

from ia_bench.common.arguments import read_arguments
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, command, say
from ia_bench.common.paths import make_writable
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.original import RECORD

USAGE = """\
python -m ia_bench_training.convert_weights checkpoint=CKPT out=FOLDER/albedo [sha256=HEX]

Reads last.ckpt of the albedo or the specular model of IntrinsicAnything and writes FOLDER/<component>/{unet,vae,image_encoder,
scheduler}: safetensors in half precision, of the UNet the moving average of its weights. Nothing in the checkpoint is executed.
Then: prior=intrinsicanything prior.options.weights=FOLDER

sha256   refuse a checkpoint with any other hash; without it the hash is printed and recorded as not verified
"""

UNET, AVERAGE = "model.diffusion_model.", "model_ema.diffusion_model"
CLIP = "cond_stage_model.model.visual."
RELEASE: dict[str, dict[str, Any]] = {  # Stable Diffusion 1 but for the input, which has the image's latents beside the noisy ones
    "unet": {
        "sample_size": 32,
        "in_channels": 8,
        "block_out_channels": [320, 640, 1280, 1280],
        "cross_attention_dim": 768,
        "attention_head_dim": 8,  # diffusers' name for the number of heads
    },
    "vae": {
        "sample_size": 256,
        "block_out_channels": [128, 256, 512, 512],
        "layers_per_block": 2,
        "down_block_types": ["DownEncoderBlock2D"] * 4,
        "up_block_types": ["UpDecoderBlock2D"] * 4,
        "scaling_factor": 0.18215,
    },
    "image_encoder": {
        "hidden_size": 1024,
        "intermediate_size": 4096,
        "num_hidden_layers": 24,
        "num_attention_heads": 16,
        "image_size": 224,
        "patch_size": 14,
        "projection_dim": 768,
        "hidden_act": "quick_gelu",
    },
}
SCHEDULE = {
    "beta_start": 0.00085,
    "beta_end": 0.012,
    "beta_schedule": "scaled_linear",
    "prediction_type": "epsilon",
    "clip_sample": False,
    "set_alpha_to_one": False,
    "steps_offset": 1,
    "timestep_spacing": "leading",
}


class _Ignored:
    """Stands for the numpy scalars of Lightning's counters, which are not read: it takes any state, and keeps none."""

    def __init__(self, *_: object) -> None: ...

    def __setstate__(self, state: object) -> None: ...


STAND_INS = [(_Ignored, name) for name in ("numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar", "numpy.dtype")]
"""The only names that a checkpoint's pickle may ask for beyond those of torch's own safe reader; numpy 1 and 2 spell them so."""


@dataclass(frozen=True)
class ConvertRequest:
    """The checkpoint, the folder of its converted weights, and the SHA-256 that it must have (None: any)."""

    checkpoint: Path
    out: Path
    sha256: str | None = None


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """The tensors of a Lightning checkpoint by key, mapped from the file: none is in memory before it is used.

    A pickle may call whatever it names. torch's ``weights_only`` reader refuses one that asks for more than tensors and plain
    containers before it follows any of it. Raises InputError for such a file, and for one that is cut off or of another kind.
    """
    try:
        with safe_globals(STAND_INS):  # type: ignore[arg-type]  # its annotation lacks the pairs that its text describes
            return dict(torch.load(path, map_location="cpu", weights_only=True, mmap=True)["state_dict"])
    except (pickle.UnpicklingError, RuntimeError, ValueError, EOFError, LookupError, TypeError, AttributeError, OSError) as error:
        reason = " ".join(str(error).rpartition("WeightsUnpickler error:")[2].split())  # before it is how to read it unsafely
        raise InputError(f"{path}: expected a Lightning checkpoint of tensors and numbers, found: {reason:.300}") from None


def convert(path: Path, folder: Path, layout: Mapping[str, dict[str, Any]]) -> None:
    """Write the three networks of the checkpoint ``path``, whose sizes are the ``layout``, and its schedule below ``folder``.

    Raises InputError naming the tensor that is missing, misshapen or beyond half precision.
    """
    from diffusers import DDIMScheduler
    from safetensors.torch import save_file

    state = read_checkpoint(path)
    for name, (model, tensors) in networks(state, layout).items():
        converted = {}
        for key, expected in model.state_dict().items():
            tensor = tensors.get(key)
            if tensor is None or tensor.shape != expected.shape:
                found = "none" if tensor is None else f"shape {tuple(tensor.shape)}"
                raise InputError(f"{path}: {name}: expected a tensor of shape {tuple(expected.shape)} for {key}, found {found}")
            converted[key] = tensor.half().contiguous()
            if not bool(converted[key].isfinite().all()):
                raise InputError(f"{path}: {name}: {key}: expected numbers below 65504 (half precision), found larger ones")
        (folder / name).mkdir(parents=True, exist_ok=True)
        stem = "model" if name == "image_encoder" else "diffusion_pytorch_model"
        save_file(converted, folder / name / f"{stem}.safetensors", metadata={"format": "pt"})  # without it, both libraries refuse
        (model.config.save_pretrained if name == "image_encoder" else model.save_config)(folder / name)
    schedule: Any = DDIMScheduler(**SCHEDULE)
    if not torch.allclose(state.get("betas", torch.zeros(())).float(), schedule.betas, rtol=0, atol=1e-6):
        raise InputError(f"{path}: betas: expected those of the release, whose square roots are evenly spaced, found others")
    schedule.save_config(folder / "scheduler")


def networks(state: Mapping[str, Tensor], layout: Mapping[str, dict[str, Any]]) -> dict[str, tuple[Any, dict[str, Tensor | None]]]:
    """Each network without memory, and the tensors of ``state`` under the names that it has in its library.

    The averaged weights of the UNet have names with the dots left out.
    """
    import_torchvision()
    from diffusers import AutoencoderKL, UNet2DConditionModel
    from diffusers.loaders.single_file_utils import convert_ldm_unet_checkpoint, convert_ldm_vae_checkpoint
    from transformers import CLIPVisionConfig, CLIPVisionModelWithProjection

    average = {key: state.get(AVERAGE + key.removeprefix(UNET).replace(".", "")) for key in state if key.startswith(UNET)}
    with torch.device("meta"):
        unet, vae = UNet2DConditionModel(**layout["unet"]), AutoencoderKL(**layout["vae"])
        encoder: Any = CLIPVisionModelWithProjection(CLIPVisionConfig(**layout["image_encoder"]))
    return {
        "unet": (unet, convert_ldm_unet_checkpoint(average, unet.config)),
        "vae": (vae, convert_ldm_vae_checkpoint(state, vae.config)),
        "image_encoder": (encoder, _of_clip({k.removeprefix(CLIP): v for k, v in state.items() if k.startswith(CLIP)})),
    }


def _of_clip(state: Mapping[str, Tensor]) -> dict[str, Tensor | None]:
    """OpenAI's CLIP image encoder under the names of transformers, where queries, keys and values are matrices of their own."""
    names = {"ln_pre": "pre_layrnorm", "ln_post": "post_layernorm", "transformer.resblocks": "encoder.layers",
             "ln_1": "layer_norm1", "ln_2": "layer_norm2", "attn": "self_attn", "mlp.c_fc": "mlp.fc1", "mlp.c_proj": "mlp.fc2",
             "conv1": "embeddings.patch_embedding", "class_embedding": "embeddings.class_embedding",
             "positional_embedding": "embeddings.position_embedding.weight"}  # fmt: skip
    found: dict[str, Tensor | None] = {"visual_projection.weight": state["proj"].T if "proj" in state else None}
    for key, tensor in state.items():
        name = f".{key}."
        for theirs, ours in names.items():
            name = name.replace(f".{theirs}.", f".{ours}.")
        name = f"vision_model{name[:-1]}"
        if "in_proj_" in name:
            parts = zip(("q_proj", "k_proj", "v_proj"), tensor.chunk(3), strict=True)
            found |= {name.replace("in_proj_", f"{part}."): values for part, values in parts}
        else:
            found[name] = tensor
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0 done, 2 a mistake in what was asked."""
    return command(lambda: USAGE, _convert, arguments)


def _convert(arguments: Sequence[str]) -> int:
    request = read_arguments(ConvertRequest, arguments)
    if not request.checkpoint.is_file() or (request.out / RECORD).exists():
        reason = f"{request.out} to convert into, found converted weights" if request.checkpoint.is_file() else "a file, found none"
        raise InputError(f"checkpoint={request.checkpoint}: expected {reason}")
    with request.checkpoint.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if request.sha256 is not None and digest != request.sha256.lower():
        raise InputError(f"{request.checkpoint}: expected SHA-256 {request.sha256.lower()}, found {digest}")
    say(f"{request.checkpoint}: SHA-256 {digest}{'' if request.sha256 else ' (not verified; sha256= does)'}", sys.stdout)
    make_writable(request.out, "out")
    convert(request.checkpoint, request.out, RELEASE)
    record = {"file": request.checkpoint.name, "sha256": digest, "verified": request.sha256 is not None}
    record |= {"written_by": {name: version(name) for name in ("ia_bench", "torch", "diffusers", "transformers")}}
    with whole_file(request.out / RECORD) as partial:  # last, so that a folder that holds it is complete
        partial.write_text(json.dumps(record, indent=1), encoding="utf-8")
    return OK


if __name__ == "__main__":
    sys.exit(main())
