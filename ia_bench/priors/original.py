"""The published IntrinsicAnything weights (ECCV 2024) behind the prior's contract, sampled as their authors' code does.

docs/original_weights.md lists where this departs from that code, and why. The networks saw the object alone, cut out along its
mask, white around it, scaled to fill a square, in gamma 2.2.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.ranges import NotNegative, Number, UnitInterval
from ia_bench.common.seeds import derive_seed
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.contract import COMPONENTS, Observations, PriorInfo, Samples
from ia_bench.priors.diffusion.framing import box_of
from ia_bench.priors.diffusion.sampler import Denoise, NoiseSchedule, SamplerSettings, image_behind, sample
from ia_bench.priors.inputs import Device, check_views, choose_device, content_number

GAMMA = 2.2
COVERED = 0.5
"""A pixel belongs to the object where more than this much of it is covered."""

CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)  # of the images that CLIP was trained on
CLIP_DEVIATION = (0.26862954, 0.26130258, 0.27577711)

RECORD = "source.json"
"""File of a folder of weights that says where they come from; the converter writes it last."""
LATENT_RANGE = (-20.0, 20.0)
"""Clip of the estimated latents, which have unit standard deviation: no sample reaches it, runaway guidance ends there."""
VERSION = 2
"""Part of the fingerprint; raised when a change of the code changes samples."""


class IntrinsicAnythingPrior:
    """Latent diffusion of albedo and of specular shading given an image, at 256 x 256.

    ``weights``: folder with what ``python -m ia_bench_training.convert_weights`` wrote, a folder a component. ``components``: which
    models to use, None for all that are there. ``steps``, ``eta``: of DDIM; the authors' are 100 (200 for high-resolution patches)
    and 1. ``guidance_strength``: the authors' scale, recommended from 2 to 5 (:func:`ia_bench.priors.original.pull`).
    ``batch``: images at a time, which changes no sample beyond rounding. ``device``: "auto", "cpu", "cuda".
    Its cost counts guided estimates and those whose step was cut. Raises InputError.
    """

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[str]:
        """What samples depend on beside code and options: the weights."""
        return [options["weights"]] if options.get("weights") else []

    def __init__(
        self,
        *,
        weights: str | None = None,
        components: Iterable[str] | None = None,
        steps: Number = 100,
        eta: UnitInterval = 1.0,
        guidance_strength: NotNegative = 3.0,
        batch: Number = 8,
        device: Device = "auto",
    ) -> None:
        folder = Path(weights or "").expanduser()
        there = [name for name in COMPONENTS if weights and is_file(folder / name / RECORD)]
        used = there if components is None else sorted(set(components))
        if not used or not set(used) <= set(there):
            expected = " and ".join(used) or "albedo or specular"
            raise InputError(
                f"prior.options.weights={weights}: expected {expected}/{RECORD} as python -m ia_bench_training.convert_weights "
                f"writes it, found {', '.join(there) or 'none'}"
            )
        self._hashes = {name: _entry(folder / name / RECORD, "sha256") for name in used}
        self._side = int(_entry(folder / used[0] / "vae" / "config.json", "sample_size"))
        self.info = PriorInfo(frozenset(used), stochastic=True, guidable=True, resolution=self._side, coupling="targets")
        self._device = choose_device(device)
        self._settings = SamplerSettings(steps, eta, "leading", LATENT_RANGE)
        self._batch = batch
        self._networks = cache(lambda component: Networks(folder / component, self._device))
        self.guidance_strength = guidance_strength

    @property
    def fingerprint(self) -> str:
        """What decides the samples: this code's version, the options, the hashes of the checkpoints, the precision."""
        options = (self._settings.steps, self._settings.eta, self.guidance_strength, self._side, self._device.type)
        return json.dumps([type(self).__qualname__, VERSION, options, self._hashes], sort_keys=True)

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`; radiance above 1 is clipped before the network sees it.

        An image's noise is seeded by ``seed``, the component and the image's own content, so that views differ in it.
        """
        check_views("intrinsicanything", observations, guidance or {}, self.info.provides)
        images, masks = observations.images, observations.masks
        cost = Counter(network_calls=0, guided_estimates=0, guided_cut=0)
        crops = {view: crop for view, mask in enumerate(masks) if (crop := Crop.of(mask, self._side)) is not None}
        samples = {name: torch.zeros_like(images, dtype=torch.float32) for name in sorted(self.info.provides)}

        def squares(linear: Tensor, views: list[int]) -> Tensor:
            return torch.stack([encode(linear[view], masks[view], crops[view], self._side) for view in views])

        for component, sampled in samples.items():
            number, render = COMPONENTS.index(component), (guidance or {}).get(component)
            for start in range(0, len(crops), self._batch):
                views = list(crops)[start : start + self._batch]
                seeds = [derive_seed(seed, number, content_number(images[view], masks[view])) for view in views]
                target = None if render is None else squares(render, views)
                drawn = self._draw(self._networks(component), squares(images, views), seeds, target, cost)
                cost["network_calls"] += self._settings.steps * len(views)
                for view, square in zip(views, drawn, strict=True):
                    sampled[view] = decode(square, masks[view], crops[view])
        ceilings = {"specular": torch.ones(len(images))} if "specular" in samples else {}  # a square ends at white
        return Samples(samples, ceilings, dict(cost))

    def _draw(self, networks: Networks, images: Tensor, seeds: list[int], target: Tensor | None, cost: Counter[str]) -> Tensor:
        """(N, 3, S, S) in the networks' encoding, like ``images`` and ``target``."""
        schedule, free = networks.schedule, networks.bind(images)
        target = target.to(self._device) if target is not None and self.guidance_strength else None

        def denoise(noisy: Tensor, t: int) -> Tensor:
            x0 = free(noisy, t)
            if target is None:
                return x0
            return pull(x0, target, networks.decode, self.guidance_strength, float(schedule.alpha_bar[t]), cost)

        reduced = self._side >> (len(networks.vae.config.block_out_channels) - 1)
        shape = len(images), networks.unet.config.out_channels, reduced, reduced
        latents = sample(denoise, schedule, shape, seeds, self._settings, device=self._device)
        with torch.no_grad():
            return networks.decode(latents).cpu()


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


def pull(
    x0: Tensor, target: Tensor, decode: Callable[[Tensor], Tensor], strength: float, alpha_bar: float, cost: Counter[str]
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
    cost.update(guided_estimates=len(x0), guided_cut=int(((longest < wanted) & (slope > 0)).sum()))
    return x0 - longest.clamp(max=wanted)[:, None, None, None] * gradient


@dataclass(frozen=True)
class Crop:
    """The object's bounding box in the image, and the box that it fills in the square (pixels; both half open)."""

    rows: slice
    columns: slice
    square_rows: slice
    square_columns: slice

    @classmethod
    def of(cls, mask: Tensor, side: int) -> Crop | None:
        """The crop of ``mask`` (H, W) for a square of ``side`` pixels; None where no pixel belongs to the object.

        The longer side of the box fills the square, the shorter one is centred, to whole pixels.
        """
        boxes = box_of(mask > COVERED)
        if boxes is None:
            return None
        longest = max(box.stop - box.start for box in boxes)
        lengths = [max(round((box.stop - box.start) * side / longest), 1) for box in boxes]
        starts = [round((side - length) / 2) for length in lengths]
        return cls(*boxes, *(slice(start, start + length) for start, length in zip(starts, lengths, strict=True)))


def encode(image: Tensor, mask: Tensor, crop: Crop, side: int) -> Tensor:
    """(3, side, side) in [0, 1], gamma 2.2, of ``image`` (H, W, 3), linear and premultiplied by ``mask`` (H, W).

    Radiance above 1 is clipped, as in the 8-bit photographs that the networks know.
    """
    colour = (image / mask.clamp(min=COVERED)[..., None]).clamp(0, 1) ** (1 / GAMMA)
    cut = torch.where((mask > COVERED)[..., None], colour, 1.0)[crop.rows, crop.columns]
    square = cut.new_ones(3, side, side)
    place = square[:, crop.square_rows, crop.square_columns]
    place[:] = _resize(cut.movedim(-1, 0), (place.shape[1], place.shape[2]))
    return square


def decode(square: Tensor, mask: Tensor, crop: Crop) -> Tensor:
    """The inverse of :func:`encode`: (H, W, 3) float32, linear, premultiplied by ``mask``.

    A pixel that is covered by half or less, white to the network, takes the colour of the nearest one that is covered more.
    """
    cut = square[:, crop.square_rows, crop.square_columns].float().cpu()
    size = crop.rows.stop - crop.rows.start, crop.columns.stop - crop.columns.start
    image = mask.new_zeros(*mask.shape, 3, dtype=torch.float32)
    image[crop.rows, crop.columns] = _resize(cut, size).movedim(0, -1) ** GAMMA
    row, column = distance_transform_edt((mask <= COVERED).numpy(), return_distances=False, return_indices=True)
    return image[torch.from_numpy(row).long(), torch.from_numpy(column).long()] * mask[..., None]


def _resize(image: Tensor, size: tuple[int, int]) -> Tensor:
    """(3, h, w) by bilinear interpolation, with a filter as wide as a target pixel where it shrinks."""
    return F.interpolate(image[None], size, mode="bilinear", antialias=True)[0].clamp(0, 1)


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


def _entry(path: Path, key: str) -> Any:  # noqa: ANN401 (a JSON value)
    content = read_json(path)
    if key not in content:
        raise InputError(f"{path}: expected JSON with the key {key}, found none")
    return content[key]
