"""The published IntrinsicAnything weights (ECCV 2024) behind the prior's contract, sampled as their authors' code does.

docs/original_weights.md lists where this departs from that code, and why. The networks saw the object alone, cut out along its
mask, white around it, scaled to fill a square, in gamma 2.2.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import is_file, read_json
from ia_bench.common.ranges import NotNegative, Number, UnitInterval
from ia_bench.common.seeds import derive_seed
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.contract import COMPONENTS, Observations, PriorInfo, Samples
from ia_bench.priors.diffusion.encoding import Frame
from ia_bench.priors.diffusion.sampler import Denoise, NoiseSchedule, SamplerSettings, image_behind, sample
from ia_bench.priors.inputs import Device, choose_device, content_number

GAMMA = 2.2
CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)  # of the images that CLIP was trained on
CLIP_DEVIATION = (0.26862954, 0.26130258, 0.27577711)
RECORD = "source.json"
"""File of a folder of weights that says where they come from; the converter writes it last."""
LATENT_RANGE = (-20.0, 20.0)
"""Clip of the estimated latents, which have unit standard deviation: no sample reaches it, runaway guidance ends there."""
VERSION = 4  # part of the fingerprint; raised when a change of the code changes samples


@dataclass(kw_only=True, eq=False)
class IntrinsicAnythingPrior:
    """Latent diffusion of albedo and of specular shading given an image, at 256 x 256.

    Its cost counts guided estimates and those whose step was cut.

    Attributes:
        weights: Folder with what ``python -m ia_bench_training.convert_weights`` wrote, a folder a component.
        steps, eta: The steps and the eta of DDIM; the authors' are 100 (200 for high-resolution patches) and 1.
        guidance_strength: The authors' scale, recommended from 2 to 5 (:func:`pull`).
        batch: Images at a time, which changes no sample beyond rounding.
        device: "auto", "cpu" or "cuda".

    Raises:
        InputError: There are no such weights.
    """

    weights: str | None = None
    steps: Number = 100
    eta: UnitInterval = 1.0
    guidance_strength: NotNegative = 3.0
    batch: Number = 8
    device: Device = "auto"

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[str]:
        """What samples depend on beside code and options: the weights."""
        return [options["weights"]] if options.get("weights") else []

    def __post_init__(self) -> None:
        self._folder = Path(self.weights or "").expanduser()
        used = [name for name in COMPONENTS if self.weights and is_file(self._folder / name / RECORD)]
        if not used:
            expected = f"albedo/{RECORD} or specular/{RECORD} as python -m ia_bench_training.convert_weights writes it"
            raise InputError(f"prior.options.weights={self.weights}: expected {expected}, found none")
        self._records = {name: read_json(self._folder / name / RECORD).get("sha256") for name in used}
        self._side = int(read_json(self._folder / used[0] / "vae" / "config.json").get("sample_size", 256))
        self.info = PriorInfo(frozenset(used), stochastic=True, guidable=True, resolution=self._side, coupling="targets")
        self._device = choose_device(self.device)
        self._settings = SamplerSettings(self.steps, self.eta, "leading", LATENT_RANGE)
        self._networks = cache(lambda component: Networks(self._folder / component, self._device))

    @property
    def fingerprint(self) -> str:
        """What decides the samples: this code's version, the options, the hashes of the checkpoints, the precision."""
        options = (self.steps, self.eta, self.guidance_strength, self._side, self._device.type)
        return json.dumps([type(self).__qualname__, VERSION, options, self._records], sort_keys=True)

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """See :meth:`ia_bench.priors.contract.Prior.sample`; radiance above 1 is clipped before the network sees it.

        An image's noise is seeded by ``seed``, the component and the image's own content, so that views differ in it.
        """
        images, masks = observations.images.float(), observations.masks.float()
        cost = Counter(network_calls=0, guided_estimates=0, guided_cut=0)
        frames = {view: frame for view, mask in enumerate(masks) if (frame := Frame.around(mask, self._side, margin=0)) is not None}
        samples = {name: torch.zeros_like(images) for name in sorted(self.info.provides)}

        def squares(linear: Tensor, views: list[int]) -> Tensor:
            return torch.stack([encode(linear[view], masks[view], frames[view]) for view in views]).to(self._device)

        for component, sampled in samples.items():
            networks, render = self._networks(component), (guidance or {}).get(component)
            for start in range(0, len(frames), self.batch):
                views = list(frames)[start : start + self.batch]
                number = COMPONENTS.index(component)
                seeds = [derive_seed(seed, number, content_number(images[view], masks[view])) for view in views]
                denoise = networks.bind(squares(images, views))
                if render is not None and self.guidance_strength:
                    denoise = self._guided(networks, denoise, squares(render, views), cost)
                latents = sample(denoise, networks.schedule, (len(views), *networks.shape), seeds, self._settings, self._device)
                cost["network_calls"] += self.steps * len(views)
                with torch.no_grad():
                    drawn = networks.decode(latents).cpu()
                for view, square in zip(views, drawn.movedim(1, -1) ** GAMMA, strict=True):
                    coverage = frames[view].cut(masks[view, ..., None])[..., 0]
                    sampled[view] = frames[view].paste(square, (coverage > 0).float(), masks[view])
        ceilings = {"specular": torch.ones(len(images))} if "specular" in samples else {}  # a square ends at white
        return Samples(samples, ceilings, dict(cost))

    def _guided(self, networks: Networks, denoise: Denoise, target: Tensor, cost: Counter[str]) -> Denoise:
        def guided(noisy: Tensor, t: int) -> Tensor:
            level = float(networks.schedule.alpha_bar[t])
            return pull(denoise(noisy, t), target, networks.decode, self.guidance_strength, level, cost)

        return guided


class Networks:
    """UNet, autoencoder, CLIP image encoder and noise schedule of ``folder`` (one component of the converter's output).

    On the GPU the UNet and CLIP compute in half precision; the autoencoder, which guidance differentiates, never does.
    Raises InputError naming the folder of what is missing or cannot be read.
    """

    def __init__(self, folder: Path, device: torch.device) -> None:
        import_torchvision()
        from diffusers import AutoencoderKL, UNet2DConditionModel
        from transformers import CLIPVisionModelWithProjection

        self.dtype = torch.float16 if device.type == "cuda" else torch.float32

        def loaded(kind: Any, name: str, **precision: torch.dtype) -> Any:  # noqa: ANN401 (a model class of either library)
            """The model in one of the folders, frozen; only safetensors are read, and nothing is fetched."""
            options = {"use_safetensors": True, "local_files_only": True, "output_loading_info": True}
            try:
                with torch.random.fork_rng(devices=[]):  # loading draws initial weights, which no run must notice
                    model, report = kind.from_pretrained(folder / name, **options, **precision)
            except Exception as error:  # whatever the libraries and their readers raise for a broken folder
                reason = " ".join(str(error).split())
                raise InputError(f"{folder / name}: expected converted weights, found: {reason:.200}") from error
            if missing := report["missing_keys"]:
                raise InputError(f"{folder / name}: expected tensors for every parameter, found none for {min(missing)}")
            return model.to(device).eval().requires_grad_(False)

        self.unet = loaded(UNet2DConditionModel, "unet", torch_dtype=self.dtype)
        self.vae = loaded(AutoencoderKL, "vae", torch_dtype=torch.float32)
        self.clip = loaded(CLIPVisionModelWithProjection, "image_encoder", dtype=self.dtype)
        self.schedule = NoiseSchedule.from_diffusers(read_json(folder / "scheduler" / "scheduler_config.json"))
        reduced = self.vae.config.sample_size >> (len(self.vae.config.block_out_channels) - 1)
        self.shape = self.unet.config.out_channels, reduced, reduced

    @torch.no_grad()
    def bind(self, images: Tensor) -> Denoise:
        """The denoiser of latents x_t (N, 4, h, w) float32 that ``images`` (N, 3, S, S) in [0, 1] condition.

        The UNet sees the mode of the autoencoder's posterior beside them, *without* the factor that scales the latents that are
        sampled. CLIP sees the image at its own size, by bicubic interpolation between corners, as in the release.
        """
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


def encode(image: Tensor, mask: Tensor, frame: Frame) -> Tensor:
    """(3, S, S) in [0, 1], gamma 2.2, white around the object, of ``image`` (H, W, 3), linear and premultiplied by ``mask`` (H, W).

    Radiance above 1 is clipped, as in the 8-bit photographs that the networks know.
    """
    colour, coverage = frame.cut(torch.cat([image, mask[..., None]], -1)).split([3, 1], -1)
    square = (colour / coverage.clamp_min(1e-3)).clamp(0, 1) ** (1 / GAMMA)
    return torch.where(coverage > 0, square, 1.0).movedim(-1, 0)
