"""Trains the refiner on fits of procedural scenes: a plain loop, every draw a function of (seed, step), so that it resumes."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, NotNegative, Number, Share
from ia_bench.priors.inputs import use_bf16
from ia_bench.priors.refiner.checkpoint import save_refiner
from ia_bench.priors.refiner.network import RENDERS, RefinerConfig, RefinerNetwork, Seen, see
from ia_bench.scenes.tensor_color import linear_to_srgb
from ia_bench.training.fit_files import CHANNELS, fit_paths, load_fit
from ia_bench.training.loop import batch_index, rate_factor
from ia_bench.training.optimiser import MuonAdamW, split_weights

FEW = 8
"""Photographs up to which a fit counts as one of few, in the figures of validation."""
COVERED = 0.9
"""Coverage from which a pixel counts."""
COLOURS = ("albedo", "radiance", "specular", "true_albedo")
"""Tensors of a fit that have the three colours of its photographs."""
ZOOM = 1.4
"""Largest factor by which a view is enlarged or reduced."""
TINT, CAST = 0.3, 0.1
"""Standard deviations of the log factors of a channel by which light, and the fit's albedo, are multiplied."""


@dataclass(frozen=True)
class RefinerSettings:
    """Everything that a training run of the refiner depends on.

    Attributes:
        data: Folder of fits to train on (``python -m ia_bench.cli.fit_data``).
        validation: Folder of fits to validate on; they have other seeds.
        out: The run's folder, in which a run resumes.
        fits: How many of the fits to train on are taken, the first ones; None for all.
        steps: Optimiser steps in all.
        batch: Views a step.
        rate: Full rate of AdamW. Rates rise over ``warmup`` steps and fall along a cosine to a fiftieth.
        muon_rate: Full rate of Muon on the hidden weights.
        roughness_weight: Of the squared error of the roughness in the loss, beside that of the albedo.
        warmup: Steps in which the rates rise.
        weight_decay: Of both optimisers.
        clip_gradient: Largest norm of the gradient.
        ema: Decay of the averaged weights, which are the ones that are kept.
        threads: Of the CPU; None for torch's own choice.
        seed: Of every draw.
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
    ema: Share = 0.999
    threads: Number | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    validate_steps: Number = 500
    network: RefinerConfig = field(default_factory=RefinerConfig)

    def identity(self) -> str:
        """Hash of what the weights depend on; a run resumes only where it is the same."""
        values = {key: value for key, value in dataclasses.asdict(self).items() if key not in ("out", "threads", "validate_steps")}
        return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:16]


class Views:
    """All views of a folder of fits, in memory as half floats."""

    def __init__(self, folder: Path, limit: int | None = None) -> None:
        """Load the fits, the first ``limit`` of them.

        Raises InputError for a folder without any, or with views of different sizes.
        """
        tensors: dict[str, list[Tensor]] = {name: [] for name in CHANNELS}
        photographs, scales, self.seeds = [], [], set[int]()
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
            self.seeds.add(info.seed)
        self.folder, self.fits = folder, len(scales)
        self._tensors = {name: torch.cat(parts) for name, parts in tensors.items()}
        self.photographs, self._scales = torch.cat(photographs), torch.cat(scales)

    def __len__(self) -> int:
        return len(self.photographs)

    def batch(self, index: Tensor, generator: torch.Generator | None = None) -> Batch:
        """Views (N,); with a ``generator`` mirrored, of another size and with other colours at random."""
        views = {name: tensor[index].float() for name, tensor in self._tensors.items()}
        scale = self._scales[index]
        if generator is not None:
            order = torch.rand(len(index), 3, generator=generator).argsort(1)
            mask, radiance = views["image"][..., 3:], views["image"][..., :3]
            views["image"] = torch.cat([_reordered(radiance, order), mask], -1)
            views |= {name: _reordered(views[name], order) for name in COLOURS}
            scale = scale.gather(1, order)
            turned = (torch.rand(len(index), generator=generator) < 0.5)[:, None, None, None]
            views["normal"] = torch.where(turned, views["normal"] * torch.tensor([-1.0, 1.0, 1.0]), views["normal"])
            views = {name: torch.where(turned, values.flip(2), values) for name, values in views.items()}
            views, scale = _recoloured(_zoomed(views, generator), scale, generator)
        image, mask = views["image"][..., :3], views["image"][..., 3]
        renders = {name: views[name] for name in RENDERS}
        seen = see(image, mask, renders, *(views[name] for name in ("normal", "visibility", "sightings")))
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
    """(3,) of a fit; None of one that shows next to nothing, or whose numbers are none."""
    inside = fit["image"][..., 3] > COVERED
    if int(inside.sum()) < 200 or not all(bool(torch.isfinite(values).all()) for values in fit.values()):
        return None
    albedo, truth = fit["albedo"][inside].float().mean(0), fit["true_albedo"][inside].float().mean(0)
    return truth / albedo.clamp_min(1e-4)


def _reordered(values: Tensor, order: Tensor) -> Tensor:
    return torch.gather(values, 3, order[:, None, None].expand_as(values))


def _zoomed(views: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Half of the views enlarged or reduced around their middle by up to ZOOM, since photographs show objects in all sizes."""
    count = len(views["image"])
    chosen = torch.rand(count, generator=generator) < 0.5
    zoom = torch.where(chosen, torch.exp((2 * torch.rand(count, generator=generator) - 1) * math.log(ZOOM)), 1.0)
    turn = torch.zeros(count, 2, 3)
    turn[:, 0, 0] = turn[:, 1, 1] = 1 / zoom
    grid = F.affine_grid(turn, list(views["image"].movedim(-1, 1).shape), align_corners=False)
    modes = {name: "nearest" if name == "sightings" else "bilinear" for name in views}  # which counts
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
    images, held_out = Views(settings.data, settings.fits), Views(settings.validation)
    shared = images.seeds & held_out.seeds
    if shared:
        raise InputError(f"{held_out.folder}: expected fits of other seeds than in {images.folder}, found seed {min(shared)}")
    torch.manual_seed(settings.seed)
    network, average = RefinerNetwork(settings.network), RefinerNetwork(settings.network)
    average.load_state_dict(network.state_dict())
    average.eval().requires_grad_(False)
    hidden, others = split_weights(network, muon=settings.muon_rate > 0)
    adamw = torch.optim.AdamW(others, lr=settings.rate, weight_decay=settings.weight_decay, fused=True)
    optimizer = MuonAdamW(adamw, hidden, muon_rate=settings.muon_rate, weight_decay=settings.weight_decay)
    bf16 = use_bf16("auto", torch.device("cpu"))
    figures: dict[str, float] = {}
    step, seconds = 0, 0.0
    state = _load_state(settings)
    if state is not None:
        if state["fits"] != images.fits:
            raise InputError(
                f"{images.folder}: expected the {state['fits']} fits that {settings.out} began with, found {images.fits}"
            )
        step, seconds = state["step"], state["seconds"]
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
    task = progress.task("training", settings.steps, step)
    while step < settings.steps:
        started = time.monotonic()
        generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + step)
        batch = images.batch(batch_index(len(images), settings.batch, settings.seed, step), generator)
        with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            change = network(batch.seen.features.to(memory_format=torch.channels_last))
        albedo, roughness = batch.errors(change.float())
        loss = albedo.mean() + settings.roughness_weight * roughness.mean()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), settings.clip_gradient)
        if not bool(torch.isfinite(norm)):
            raise FloatingPointError(f"step {step}: the gradient is NaN or Inf; the last checkpoint is kept")
        optimizer.step(rate_factor(step, settings.steps, settings.warmup))
        decay = min(settings.ema, (1 + step) / (10 + step))
        with torch.no_grad():
            for mean, weight in zip(average.parameters(), network.parameters(), strict=True):
                mean.lerp_(weight, 1 - decay)
        step += 1
        seconds += time.monotonic() - started
        task.advance(1, loss=float(loss.detach()))
        if step % settings.validate_steps == 0 or step == settings.steps:
            figures = score(average, held_out)
            progress.note(f"step {step}, {seconds:.0f} s: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
            with (settings.out / "validation.jsonl").open("a") as file:
                file.write(json.dumps({"step": step, "seconds": round(seconds, 1), **figures}) + "\n")
            kept = {"identity": settings.identity(), "fits": images.fits, "step": step, "seconds": seconds}
            kept["network"] = network.state_dict()
            with whole_file(settings.out / "state.pt") as partial:
                torch.save({**kept, "average": average.state_dict(), "optimizer": optimizer.state_dict()}, partial)
            about = {"steps": step, "seconds": round(seconds), "fits": images.fits, "views": len(images), "figures": figures}
            save_refiner(settings.out / "weights", average, {**about, "batch": settings.batch, "seed": settings.seed})
    return figures


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


def _load_state(settings: RefinerSettings) -> dict[str, Any] | None:
    settings.out.mkdir(parents=True, exist_ok=True)
    path = settings.out / "state.pt"
    if not path.exists():
        return None
    state: dict[str, Any] = torch.load(path, weights_only=True)
    if state["identity"] != settings.identity():
        raise InputError(f"{settings.out}: expected a run with these settings, found one with others. Give another out= folder")
    return state
