"""Trains the refiner on fits of procedural scenes: a plain loop, every draw a function of (seed, step), so that it resumes."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, NotNegative, Number, UnitInterval
from ia_bench.priors.refiner import RENDERS, RefinerConfig, RefinerNetwork, Seen, see
from ia_bench.scenes.color import linear_to_srgb
from ia_bench_training.dataset import reordered
from ia_bench_training.fit_files import CHANNELS, fit_paths, load_fit
from ia_bench_training.optimiser import MuonAdamW, split_weights
from ia_bench_training.resuming import (
    batch_index,
    check_gradient,
    check_seeds,
    identity,
    rate_factor,
    run,
    write_validation,
)
from ia_bench_training.saving import save_refiner
from ia_bench_training.speed import trains_in_bf16

FEW = 8
"""A fit with at most so many photographs counts as one of few, in the figures of validation."""
COVERED = 0.9
"""Pixels of more coverage than this count, in the loss and in the figures."""
LEAST_PIXELS = 200
"""A fit counts if its views show at least so many such pixels."""
BLACK = 1e-4
"""The mean of a fit's albedo is taken to be this where it is less, so that a scale to the truth is finite."""
COLOURS = ("albedo", "radiance", "specular", "true_albedo")
"""Tensors of a fit that have the three colours of its photographs."""
ZOOM = 1.4
"""Views are enlarged or reduced by at most this factor."""
TINT, CAST = 0.3, 0.1
"""Light is multiplied by a factor a channel, and the fit's albedo by another: these are the standard deviations of their logs."""


@dataclass(frozen=True)
class RefinerSettings:
    """Everything that a training run of the refiner depends on.

    Attributes:
        data: Folder of fits to train on (``python -m ia_bench_training.fit_data``).
        validation: Folder of fits to validate on; they have other seeds.
        out: The run's folder, in which a run resumes.
        fits: How many of the fits to train on are taken, the first ones; None for all.
        steps: Optimiser steps in all.
        batch: Views a step.
        rate: Full rate of AdamW. Rates rise over ``warmup`` steps and fall along a cosine to a fiftieth.
        muon_rate: Full rate of Muon on the hidden weights.
        roughness_weight: Weight of the squared error of the roughness in the loss, beside that of the albedo.
        warmup: Steps in which the rates rise.
        weight_decay: Weight decay of both optimisers.
        clip_gradient: Largest norm of the gradient; 0 for no limit.
        ema: Decay of the averaged weights, which are the ones that are kept.
        threads: Threads of the CPU; None for torch's own choice.
        seed: Seed of every draw.
        validate_steps: Steps between two validations, after each of which the state is kept.
        network: What is trained.
    """

    data: Path
    validation: Path
    out: Path
    fits: Number | None = None
    steps: Number = 3000
    batch: Number = 16
    rate: NotNegative = 5e-4
    muon_rate: NotNegative = 0.005
    roughness_weight: NotNegative = 0.1
    warmup: Count = 100
    weight_decay: NotNegative = 0.01
    clip_gradient: NotNegative = 1.0
    ema: UnitInterval = 0.999
    threads: Number | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    validate_steps: Number = 500
    network: RefinerConfig = field(default_factory=RefinerConfig)

    def identity(self) -> str:
        """Hash of what the weights depend on; a run resumes only where it is the same."""
        free = ("out", "threads", "validation", "validate_steps")
        return identity({key: value for key, value in dataclasses.asdict(self).items() if key not in free})


class Views:
    """All views of a folder of fits, in memory as half floats."""

    def __init__(self, folder: Path, limit: int | None = None) -> None:
        """Load the fits, the first ``limit`` of them.

        Raises InputError for a folder without any, without one that shows something, or with views of different sizes.
        """
        tensors: dict[str, list[Tensor]] = {name: [] for name in CHANNELS}
        photographs, scales, seeds = [], [], set[int]()
        for path in fit_paths(folder)[:limit]:
            fit, info = load_fit(path)
            if tensors["image"] and fit["image"].shape[1:] != tensors["image"][0].shape[1:]:
                raise InputError(f"{path}: expected views of {tensors['image'][0].shape[1]} pixels, found {fit['image'].shape[1]}")
            scale = _scale(fit)
            if scale is None:
                continue
            for name in CHANNELS:
                tensors[name].append(fit[name])
            photographs.append(torch.full((len(fit["image"]),), info.photographs))
            scales.append(scale.expand(len(fit["image"]), 3))
            seeds.add(info.seed)
        if not scales:
            raise InputError(f"{folder}: expected fits that show something and are finite, found none")
        self.folder, self.fits, self.seeds = folder, len(scales), frozenset(seeds)
        self._tensors = {name: torch.cat(parts) for name, parts in tensors.items()}
        self.photographs, self._scales = torch.cat(photographs), torch.cat(scales)
        self.size = self._tensors["image"].shape[1]

    def __len__(self) -> int:
        return len(self.photographs)

    def batch(self, index: Tensor, generator: torch.Generator | None = None) -> Batch:
        """Views (N,); with a ``generator`` mirrored, of another size and with other colours at random."""
        views = {name: tensor[index].float() for name, tensor in self._tensors.items()}
        scale = self._scales[index]
        if generator is not None:
            order = torch.rand(len(index), 3, generator=generator).argsort(1)
            mask, radiance = views["image"][..., 3:], views["image"][..., :3]
            views["image"] = torch.cat([reordered(radiance, order), mask], -1)
            views |= {name: reordered(views[name], order) for name in COLOURS}
            scale = scale.gather(1, order)
            turned = (torch.rand(len(index), generator=generator) < 0.5)[:, None, None, None]
            views["normal"] = torch.where(turned, views["normal"] * torch.tensor([-1.0, 1.0, 1.0]), views["normal"])
            views = {name: torch.where(turned, values.flip(2), values) for name, values in views.items()}
            views, scale = _recoloured(_zoomed(views, generator), scale, generator)
        image, mask = views["image"][..., :3], views["image"][..., 3]
        renders = {name: views[name] for name in RENDERS}
        seen = see(image, mask, renders, *(views[name] for name in ("normal", "visibility", "view_count")))
        return Batch(seen, views["true_albedo"], views["true_roughness"], scale, (mask > COVERED).float()[..., None])


@dataclass(frozen=True)
class Batch:
    """Views to correct.

    Attributes:
        seen: What the network is given.
        albedo: (N, H, W, 3), the true one.
        roughness: (N, H, W, 1), the true one.
        scale: (N, 3), by which the fit's albedo, all of its views together, is as bright as the truth.
        inside: (N, H, W, 1), pixels that count.
    """

    seen: Seen
    albedo: Tensor
    roughness: Tensor
    scale: Tensor
    inside: Tensor

    def errors(self, change: Tensor) -> tuple[Tensor, Tensor]:
        """Mean squares (N,) of the errors that a ``change`` (N, 4, H, W) leaves in the albedo, as on a display, and roughness."""
        albedo, roughness = self.seen.corrected(change)
        shown = linear_to_srgb((albedo * self.scale[:, None, None]).clamp(1e-6, 2))
        differences = (shown - linear_to_srgb(self.albedo.clamp(0, 1)), roughness - self.roughness)
        pixels = self.inside.sum((1, 2, 3)).clamp_min(1)
        squares = [(each * self.inside).square().mean(-1).sum((1, 2)) / pixels for each in differences]
        return squares[0], squares[1]


def _scale(fit: dict[str, Tensor]) -> Tensor | None:
    """By what (3,) the mean albedo of a ``fit`` is multiplied to be the true one; None if it shows nothing or is not finite."""
    inside = fit["image"][..., 3] > COVERED
    if int(inside.sum()) < LEAST_PIXELS or not all(bool(torch.isfinite(values).all()) for values in fit.values()):
        return None
    albedo, truth = fit["albedo"][inside].float().mean(0), fit["true_albedo"][inside].float().mean(0)
    return truth / albedo.clamp_min(BLACK)


def _zoomed(views: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Half of the views enlarged or reduced around their middle by up to ZOOM, since photographs show objects in all sizes."""
    count = len(views["image"])
    chosen = torch.rand(count, generator=generator) < 0.5
    zoom = torch.where(chosen, torch.exp((2 * torch.rand(count, generator=generator) - 1) * math.log(ZOOM)), 1.0)
    turn = torch.zeros(count, 2, 3)
    turn[:, 0, 0] = turn[:, 1, 1] = 1 / zoom
    grid = F.affine_grid(turn, list(views["image"].movedim(-1, 1).shape), align_corners=False)
    modes = {name: "nearest" if name == "view_count" else "bilinear" for name in views}  # which counts
    return {
        name: F.grid_sample(values.movedim(-1, 1), grid, mode=modes[name], align_corners=False).movedim(1, -1)
        for name, values in views.items()
    }


def _recoloured(views: dict[str, Tensor], scale: Tensor, generator: torch.Generator) -> tuple[dict[str, Tensor], Tensor]:
    """Views under a light of another colour, and fits that split light and albedo at another colour, with their ``scale`` (N, 3).

    Radiance is linear in the light, and images of matt objects are the same for (albedo * c, light / c), so both are views of
    fits that could have been.
    """
    tint, cast = (torch.exp(deviation * torch.randn(scale.shape, generator=generator)) for deviation in (TINT, CAST))
    coverage = torch.ones(len(scale), 1)
    factors = {"image": torch.cat([tint, coverage], 1), "radiance": tint, "specular": tint, "albedo": cast}
    recoloured = {name: views[name] * factor[:, None, None] for name, factor in factors.items()}
    return views | recoloured, scale / cast


def train_refiner(settings: RefinerSettings, progress: Progress) -> dict[str, float]:
    """Train (or go on training) and return the last figures; the weights are in ``settings.out``/weights.

    Figures are PSNR of the albedo in dB, means over views, one scale a channel and fit, and the root of the mean squared error of
    the roughness: of the fits and of what the network makes of them, of those with at most FEW photographs and of the others.
    """
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    trainee = _Training(settings, progress)
    run(
        trainee,
        settings.out,
        steps=settings.steps,
        identity=settings.identity(),
        progress=progress,
        validate_steps=settings.validate_steps,
    )
    return trainee.figures


class _Training:
    """The state of one training run."""

    def __init__(self, settings: RefinerSettings, progress: Progress) -> None:
        self.settings, self.progress = settings, progress
        self.images, self.held_out = Views(settings.data, settings.fits), Views(settings.validation)
        check_seeds("fits", self.images, self.held_out)
        for views in (self.images, self.held_out):
            stride = settings.network.stride
            if views.size % stride or views.size == stride:
                shape = f"for network.channels={list(settings.network.channels)}"
                raise InputError(f"{views.folder}: expected views of several times {stride} pixels {shape}, found {views.size}")
        torch.manual_seed(settings.seed)
        self.network = RefinerNetwork(settings.network)
        self.average = copy.deepcopy(self.network).eval().requires_grad_(False)
        hidden, others = split_weights(self.network, muon=settings.muon_rate > 0)
        adamw = torch.optim.AdamW(others, lr=settings.rate, weight_decay=settings.weight_decay, fused=True)
        self.optimizer = MuonAdamW(adamw, hidden, muon_rate=settings.muon_rate, weight_decay=settings.weight_decay)
        self.bf16 = trains_in_bf16("auto", torch.device("cpu"))
        self.figures: dict[str, float] = {}

    def step(self, number: int) -> float:
        """See :class:`ia_bench_training.resuming.Trainee`."""
        settings, step = self.settings, number
        generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + step)
        batch = self.images.batch(batch_index(len(self.images), settings.batch, settings.seed, step), generator)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            change = self.network(batch.seen.features.to(memory_format=torch.channels_last))
        albedo, roughness = batch.errors(change.float())
        loss = albedo.mean() + settings.roughness_weight * roughness.mean()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), settings.clip_gradient or math.inf)
        check_gradient(norm, self.network)
        self.optimizer.step(rate_factor(step, settings.steps, settings.warmup))
        decay = min(settings.ema, (1 + step) / (10 + step))
        with torch.no_grad():
            for mean, weight in zip(self.average.parameters(), self.network.parameters(), strict=True):
                mean.lerp_(weight, 1 - decay)
        return float(loss.detach())

    def validate(self, done: int, seconds: float) -> None:
        """See :class:`ia_bench_training.resuming.Trainee`."""
        self.figures = score(self.average, self.held_out)
        shown = ", ".join(f"{name} {value:.4g}" for name, value in self.figures.items())
        self.progress.note(f"step {done}, {seconds:.0f} s: {shown}")
        write_validation(self.settings.out, done, seconds, self.figures)

    def save(self, done: int, seconds: float) -> None:
        """See :class:`ia_bench_training.resuming.Trainee`."""
        settings = self.settings
        provenance = {
            "steps": done,
            "seconds": round(seconds),
            "fits": self.images.fits,
            "views": len(self.images),
            "figures": self.figures,
            "batch": settings.batch,
            "seed": settings.seed,
        }
        save_refiner(settings.out / "weights", self.average, provenance)

    def state_dict(self) -> dict[str, Any]:
        """Return the weights, their average, the optimiser's moments, and what goes with them."""
        return {
            "figures": self.figures,
            "fits": self.images.fits,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state. Raises InputError for one of other fits."""
        if state["fits"] != self.images.fits:
            began = f"expected the {state['fits']} fits that {self.settings.out} began with"
            raise InputError(f"{self.images.folder}: {began}, found {self.images.fits}")
        self.figures = state["figures"]
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])


@torch.no_grad()
def score(network: RefinerNetwork, views: Views) -> dict[str, float]:
    """See :func:`train_refiner`."""
    errors: dict[str, list[Tensor]] = {"fit": [], "refined": []}
    for index in torch.arange(len(views)).split(32):
        batch = views.batch(index)
        change = network(batch.seen.features)
        errors["fit"].append(torch.stack(batch.errors(torch.zeros_like(change)), 1))
        errors["refined"].append(torch.stack(batch.errors(change), 1))
    few = views.photographs <= FEW
    figures = {}
    for name, chosen in (("few", few), ("many", ~few)):
        for what, squares in errors.items():
            if bool(chosen.any()):
                albedo, roughness = torch.cat(squares)[chosen].unbind(1)
                figures[f"{name}_{what}"] = round(float(-10 * torch.log10(albedo.clamp_min(1e-10)).mean()), 3)
                figures[f"{name}_{what}_roughness"] = round(float(roughness.mean().sqrt()), 4)
    return figures
