"""Convert the original release's checkpoints once, to safetensors that diffusers and transformers read."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.paths import make_writable
from ia_bench.common.ranges import Number
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.original import layout
from ia_bench.priors.original.checkpoint import Checkpoint, open_checkpoint, sha256
from ia_bench.priors.original.names import Source, clip_source, unet_sources, vae_sources

RECORD = "source.json"
"""Written last, so that a folder which holds it is complete: where the weights come from."""

@dataclass(frozen=True)
class Request:
    """Which checkpoints, with the SHA-256 that each must have (None: any), and where the converted weights go."""

    out: Path
    albedo: Path | None = None
    specular: Path | None = None
    albedo_sha256: str | None = None
    specular_sha256: str | None = None
    resolution: Number = layout.RESOLUTION

    def __post_init__(self) -> None:
        if not self.checkpoints:
            raise InputError("expected albedo=CKPT or specular=CKPT or both, found neither; --help says more")

    @property
    def checkpoints(self) -> dict[str, Path]:
        """The files by component."""
        return {name: path for name, path in (("albedo", self.albedo), ("specular", self.specular)) if path is not None}


def convert(request: Request, tell: Callable[[str], None] = print) -> None:
    """Convert every checkpoint asked for; one that was converted before is left alone. ``tell`` receives progress.

    Takes about as much memory as one network in half precision. Raises InputError naming the file, and the key where
    one tensor is to blame: a wrong hash, a file that is cut off or refused, a tensor that is missing or misshapen.
    """
    digests = {component: _checked_digest(request, component) for component in request.checkpoints}
    make_writable(request.out, "out")
    for component, path in request.checkpoints.items():
        folder, digest, expected = request.out / component, digests[component], getattr(request, f"{component}_sha256")
        tell(f"{component}: {path}, SHA-256 {digest}{'' if expected else f' (not verified; {component}_sha256= does)'}")
        if (folder / RECORD).is_file():
            found = _read_record(folder / RECORD)
            there = f"out={request.out}: {component} is there already"
            if found["sha256"] != digest:
                raise InputError(f"{there}, converted from another file ({found['sha256']})")
            if found["resolution"] != request.resolution:
                raise InputError(f"{there}, for resolution={found['resolution']}")
            tell(f"{component}: converted before, nothing to do")
            continue
        convert_component(open_checkpoint(path), folder, request.resolution, tell)
        record = {
            "component": component,
            "file": path.name,
            "sha256": digest,
            "verified": expected is not None,
            "resolution": request.resolution,
            "weights": "exponential moving average, half precision",
            "written_by": {name: version(name) for name in ("ia_bench", "torch", "diffusers", "transformers")},
        }
        with whole_file(folder / RECORD) as partial:
            partial.write_text(json.dumps(record, indent=1), encoding="utf-8")


def convert_component(checkpoint: Checkpoint, folder: Path, resolution: int, tell: Callable[[str], None] = print) -> None:
    """Write the four parts of one model below ``folder``, one after the other. Raises InputError as :func:`convert`."""
    import_torchvision()
    from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
    from safetensors.torch import save_file
    from transformers import CLIPVisionConfig, CLIPVisionModelWithProjection

    vae = layout.vae_config(checkpoint, resolution)
    reduction = 1 << (len(vae["block_out_channels"]) - 1)
    if resolution % reduction:
        raise InputError(f"resolution: expected a multiple of {reduction} (the autoencoder's reduction), found {resolution}")
    unet = layout.unet_config(checkpoint, resolution // reduction)
    clip = CLIPVisionConfig(**layout.clip_config(checkpoint))
    scheduler: Any = DDIMScheduler(**layout.scheduler_config(checkpoint))

    with torch.device("meta"):  # names and shapes, no memory
        encoder: Any = CLIPVisionModelWithProjection(clip)
        parts: list[tuple[str, Any, Mapping[str, Source], str]] = [
            ("unet", UNet2DConditionModel(**unet), unet_sources(checkpoint, unet), "diffusion_pytorch_model"),
            ("vae", AutoencoderKL(**vae), vae_sources(checkpoint, vae), "diffusion_pytorch_model"),
            ("image_encoder", encoder, {key: clip_source(key) for key in encoder.state_dict()}, "model"),
        ]
    for name, model, sources, stem in parts:
        shapes = {key: tuple(value.shape) for key, value in model.state_dict().items()}
        tensors = half_precision(checkpoint, shapes, sources)
        (folder / name).mkdir(parents=True, exist_ok=True)
        with whole_file(folder / name / f"{stem}.safetensors") as partial:
            save_file(tensors, partial, metadata={"format": "pt"})  # both libraries refuse a file that does not say so
        save_config = clip.save_pretrained if model.config is clip else model.save_config
        save_config(folder / name)
        tell(f"{folder / name}: {sum(tensor.numel() for tensor in tensors.values()) / 1e6:.1f} million parameters")
    scheduler.save_config(folder / "scheduler")


def _checked_digest(request: Request, component: str) -> str:
    path, expected = request.checkpoints[component], getattr(request, f"{component}_sha256")
    if not path.is_file():
        raise InputError(f"{component}={path}: no such file")
    digest = sha256(path)
    if expected is not None and digest != expected.lower():
        raise InputError(f"{path}: expected SHA-256 {expected.lower()}, found {digest}")
    return digest


def _read_record(path: Path) -> dict[str, Any]:
    record = read_json(path)
    if not {"sha256", "resolution"} <= record.keys():
        raise InputError(f"{path}: expected a record with sha256 and resolution; delete the folder to convert again")
    return record


def half_precision(
    checkpoint: Checkpoint, shapes: Mapping[str, tuple[int, ...]], sources: Mapping[str, Source]
) -> dict[str, Tensor]:
    """The parameters of ``shapes``, each taken from where ``sources`` says, as float16.

    Raises InputError naming file and key: one that is missing, has another shape, or does not fit half precision.
    """
    parameters = {}
    for name, shape in shapes.items():
        if name not in sources:
            raise InputError(f"{checkpoint.path}: expected a tensor for {name}, found none that is its")
        key, take = sources[name]
        tensor = checkpoint.tensor(key)
        try:
            value = take(tensor)
        except (IndexError, RuntimeError):  # too few axes to take anything from
            value = tensor
        if tuple(value.shape) != shape:
            raise InputError(f"{checkpoint.path}: {key}: expected shape {shape} for {name}, found {tuple(tensor.shape)}")
        half = value.to(torch.float16)
        if not bool(torch.isfinite(half).all()):
            largest = float(value.abs().max())
            raise InputError(f"{checkpoint.path}: {key}: expected numbers below 65504 (half precision), found {largest:.4g}")
        parameters[name] = half.contiguous()
    return parameters
