"""The networks of one converted model (docs/original_weights.md), what they see of an image, and how guidance reaches them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.guidance import GuidanceReport
from ia_bench.priors.diffusion.schedule import Denoise, NoiseSchedule, image_behind

CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)  # of the images that CLIP was trained on
CLIP_DEVIATION = (0.26862954, 0.26130258, 0.27577711)

RECORD = "source.json"
"""File of a folder of weights that says where they come from; the converter writes it last."""


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
        self.schedule = NoiseSchedule.from_diffusers(read_json(folder / "scheduler" / "scheduler_config.json"))

    def latent_shape(self, count: int, side: int) -> tuple[int, int, int, int]:
        """Shape of the latents of ``count`` square images."""
        reduced = side >> (len(self.vae.config.block_out_channels) - 1)
        return count, self.unet.config.out_channels, reduced, reduced

    @torch.no_grad()
    def bind(self, images: Tensor) -> Denoise:
        """The denoiser of latents x_t (N, 4, h, w) float32 that ``images`` (N, 3, S, S) in [0, 1] condition.

        The UNet sees the mode of the autoencoder's posterior beside them, *without* the factor that scales the latents that are
        sampled. CLIP sees the image at its own size, by bicubic interpolation between corners, as in the release.
        """
        images = images.to(self.device)
        latents = self.vae.encode(2 * images - 1).latent_dist.mode()
        side = self.clip.config.image_size
        seen = F.interpolate(images, (side, side), mode="bicubic", align_corners=True)
        mean, deviation = (seen.new_tensor(values)[:, None, None] for values in (CLIP_MEAN, CLIP_DEVIATION))
        tokens = self.clip(pixel_values=((seen - mean) / deviation).to(self.dtype)).image_embeds[:, None]

        @torch.no_grad()
        def denoise(noisy: Tensor, t: int) -> Tensor:
            both = torch.cat([noisy, latents], 1).to(self.dtype)
            noise = self.unet(both, t, encoder_hidden_states=tokens.to(self.dtype)).sample
            return image_behind(noise.float(), noisy, float(self.schedule.alpha_bar[t]))

        return denoise

    def decode(self, latents: Tensor) -> Tensor:
        """Images (N, 3, S, S) in [0, 1] of latents (N, 4, h, w); differentiable."""
        decoded = self.vae.decode(latents / self.vae.config.scaling_factor).sample
        return (0.5 * decoded + 0.5).clamp(0, 1)


def _load(kind: Any, folder: Path, **precision: torch.dtype) -> Any:  # noqa: ANN401 (a model class of either library)
    """The model of that class in ``folder``, frozen; only safetensors are read, and nothing is fetched."""
    try:
        options = {"use_safetensors": True, "local_files_only": True, "output_loading_info": True}
        model, report = kind.from_pretrained(folder, **options, **precision)
    except Exception as error:  # whatever the libraries and their readers raise for a broken folder
        raise InputError(f"{folder}: expected converted weights, found: {' '.join(str(error).split()):.200}") from error
    if report["missing_keys"]:
        raise InputError(f"{folder}: expected tensors for every parameter, found none for {min(report['missing_keys'])}")
    return model.eval().requires_grad_(False)


def pull(
    x0: Tensor, target: Tensor, decode: Callable[[Tensor], Tensor], strength: float, alpha_bar: float, report: GuidanceReport
) -> Tensor:
    """The estimate ``x0`` (N, C, h, w) drawn toward ``target`` (N, 3, S, S), the space of ``decode``; not clipped.

    It is the paper's rule of :mod:`ia_bench.priors.diffusion.guidance` with the autoencoder's decoder D for an operator, and with
    nothing differentiated through the network, as in the original code. With a = sqrt(alpha_bar_t), b = sqrt(1 - alpha_bar_t):

        phi = |D(x_0) - target|,   eps <- eps + strength grad_{x_t} phi,   that is   x_0 <- x_0 - strength (b / a^2) grad_{x_0} phi

    b / a^2 is 206 at the first of 200 levels; the original's step then carries the estimate far past the render. Here a step ends
    where phi would vanish if it were linear, at Polyak's length phi / |grad phi|^2; steps that were cut are counted.
    """
    with torch.enable_grad():
        variable = x0.detach().requires_grad_()
        distance = (decode(variable) - target).flatten(1).norm(dim=1)
        (gradient,) = torch.autograd.grad(distance.sum(), variable)
    slope = gradient.flatten(1).square().sum(1)  # zero where the decoder is saturated, or the target reached
    longest = torch.where(slope > 0, distance.detach() / slope, 0.0)
    wanted = strength * math.sqrt(1 - alpha_bar) / alpha_bar
    report.add((longest < wanted) & (slope > 0))
    return x0 - longest.clamp(max=wanted)[:, None, None, None] * gradient
