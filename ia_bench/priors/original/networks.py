"""The networks of one converted model, and the four things that sampling asks of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.network import CLIP_DEVIATION, CLIP_MEAN
from ia_bench.priors.diffusion.schedule import NoiseSchedule, image_behind


@dataclass(frozen=True)
class Condition:
    """What the network is told of N images: ``latents`` (N, 4, h, w) of the autoencoder, ``tokens`` (N, 1, D) of CLIP."""

    latents: Tensor
    tokens: Tensor


class Networks:
    """UNet, autoencoder, CLIP image encoder and noise schedule of ``folder`` (one component of the converter's output).

    On the GPU the UNet and CLIP compute in half precision; the autoencoder, which guidance differentiates, never does.
    Raises InputError naming the folder of what is missing or cannot be read.
    """

    def __init__(self, folder: Path, device: torch.device) -> None:
        import_torchvision()
        from diffusers import AutoencoderKL, UNet2DConditionModel
        from transformers import CLIPVisionModelWithProjection
        from transformers.utils import logging

        logging.disable_progress_bar()
        self.device, self.dtype = device, torch.float16 if device.type == "cuda" else torch.float32
        with torch.random.fork_rng(devices=[]):  # loading draws initial weights, which no run must notice
            self.unet = _load(UNet2DConditionModel, folder / "unet", torch_dtype=self.dtype).to(device)
            self.vae = _load(AutoencoderKL, folder / "vae", torch_dtype=torch.float32).to(device)
            self.clip = _load(CLIPVisionModelWithProjection, folder / "image_encoder", dtype=self.dtype).to(device)
        path = folder / "scheduler" / "scheduler_config.json"
        try:
            self.schedule = NoiseSchedule.from_diffusers(read_json(path))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from None

    def latent_shape(self, count: int, side: int) -> tuple[int, int, int, int]:
        """Shape of the latents of ``count`` square images."""
        reduced = side >> (len(self.vae.config.block_out_channels) - 1)
        return count, self.unet.config.out_channels, reduced, reduced

    @torch.no_grad()
    def condition(self, images: Tensor) -> Condition:
        """The condition of ``images`` (N, 3, S, S) in [0, 1].

        Latents are the mode of the autoencoder's posterior, *without* the factor that scales the latents that are sampled.
        CLIP sees the image at its own size, by bicubic interpolation between corners, as in the release.
        """
        images = images.to(self.device)
        latents = self.vae.encode(2 * images - 1).latent_dist.mode()
        side = self.clip.config.image_size
        seen = F.interpolate(images, (side, side), mode="bicubic", align_corners=True)
        mean, deviation = (seen.new_tensor(values)[:, None, None] for values in (CLIP_MEAN, CLIP_DEVIATION))
        tokens = self.clip(pixel_values=((seen - mean) / deviation).to(self.dtype)).image_embeds
        return Condition(latents, tokens[:, None])

    @torch.no_grad()
    def estimate(self, noisy: Tensor, t: int, condition: Condition) -> Tensor:
        """The estimate of the clean latents x_0 behind ``noisy`` x_t (N, 4, h, w) float32, by one evaluation."""
        both = torch.cat([noisy, condition.latents], 1).to(self.dtype)
        noise = self.unet(both, t, encoder_hidden_states=condition.tokens.to(self.dtype)).sample
        return image_behind(noise.float(), noisy, float(self.schedule.alpha_bar[t]))

    def decode(self, latents: Tensor) -> Tensor:
        """Images (N, 3, S, S) in [0, 1] of latents (N, 4, h, w); differentiable."""
        decoded = self.vae.decode(latents / self.vae.config.scaling_factor).sample
        return (0.5 * decoded + 0.5).clamp(0, 1)


def _load(kind: Any, folder: Path, **precision: torch.dtype) -> Any:  # noqa: ANN401 (a model class of either library)
    """The model of that class in ``folder``, frozen; only safetensors are read, and nothing is fetched."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected what python -m ia_bench_training.convert_weights writes")
    options = {"use_safetensors": True, "local_files_only": True, "output_loading_info": True}
    try:
        model, report = kind.from_pretrained(folder, **options, **precision)
    except Exception as error:  # whatever the libraries and their readers raise for a broken folder
        reason = str(error).strip().splitlines()
        raise InputError(f"{folder}: cannot be loaded: {reason[0] if reason else type(error).__name__}") from error
    missing = sorted(report["missing_keys"])
    if missing:
        raise InputError(f"{folder}: expected tensors for every parameter, found none for {', '.join(missing[:3])}")
    return model.eval().requires_grad_(False)
