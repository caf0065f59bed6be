"""How good a network is on held-out images, against taking the image itself as albedo and against constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ia_bench.priors.diffusion.encoding import decode
from ia_bench.priors.diffusion.network import Conditioned, MaterialNetwork
from ia_bench.priors.diffusion.sampler import SamplerSettings, sample
from ia_bench_training.dataset import NO_AUGMENTATION, Batch, TrainingImages, encode

MEAN_SAMPLES = 8


@dataclass(frozen=True)
class SingleView:
    """Scores of single images, of linear values inside the mask.

    The names of figures begin with what is scored: ``albedo``, scaled by one factor per image so that its mean is the truth's
    (``..._channels``: one factor per channel), or ``specular``, exposed radiance clipped at white, without alignment. They go
    on with what is taken for it: ``image``, the image itself; ``grey``, one colour; ``one`` sample; the ``mean`` of 8; the best
    ``constant``.

    Attributes:
        figures: PSNR in dB, means over the images that show something, by name.
        pictures: (N, H, W, 3) to look at, by name.
    """

    figures: dict[str, float]
    pictures: dict[str, Tensor]


@torch.no_grad()
def score_single_view(network: MaterialNetwork, images: TrainingImages, index: Tensor, *, steps: int, seed: int) -> SingleView:
    """Sample what ``network`` makes of held-out images (N,), without geometry, and score it."""
    linear = images.linear(index)
    batch = encode(linear, network.config, NO_AUGMENTATION, torch.Generator().manual_seed(seed))
    inside = batch.masks > 0.5
    predictions = predict(network, batch, samples=MEAN_SAMPLES, steps=steps, seed=seed)
    radiance, scale = linear["image"][..., :3], batch.factor[:, None, None, None]
    pictures = {"image": (radiance * scale).clamp(0, 1)}
    for component, drawn in predictions.items():
        shown = torch.ones_like(scale) if component == "albedo" else scale
        parts = {"": linear[component], "_one": drawn[0], "_mean": drawn.mean(0)}
        pictures |= {f"{component}{part}": (value * shown).clamp(0, 1) for part, value in parts.items()}
    scored = psnr_by_name(radiance, inside, batch.factor, linear, predictions)
    return SingleView({name: float(values.nanmean()) for name, values in scored.items()}, pictures)


def psnr_by_name(
    images: Tensor, inside: Tensor, factor: Tensor, truth: Mapping[str, Tensor], drawn: Mapping[str, Tensor]
) -> dict[str, Tensor]:
    """PSNR (N,) of samples ``drawn`` (S, N, H, W, 3) by component; :class:`SingleView` says what the names mean.

    Args:
        images: (N, H, W, 3), of which the samples are.
        inside: (N, H, W) bool, the pixels that count.
        factor: (N,), at which specular shading is exposed.
        truth: Component -> (N, H, W, 3).
        drawn: Component -> samples, linear.
    """
    figures = {}
    if "albedo" in drawn:
        found = {"one": drawn["albedo"][0], "mean": drawn["albedo"].mean(0)}
        for name, value in {"image": images, "grey": torch.ones_like(images), **found}.items():
            for kind, channels in (("", False), ("_channels", True)):
                figures[f"albedo_{name}{kind}"] = aligned_psnr(value, truth["albedo"], inside, channels=channels)
    if "specular" in drawn:
        exposed, weight = factor[:, None, None, None], inside[..., None].float()
        true = (truth["specular"] * exposed).clamp(0, 1)
        constant = (true * weight).sum((1, 2), keepdim=True) / weight.sum((1, 2), keepdim=True).clamp_min(1)
        samples = drawn["specular"] * exposed
        for name, value in {"constant": constant.expand_as(true), "one": samples[0], "mean": samples.mean(0)}.items():
            figures[f"specular_{name}"] = psnr(value.clamp(0, 1), true, inside)
    return figures


def predict(network: MaterialNetwork, batch: Batch, *, samples: int, steps: int, seed: int) -> dict[str, Tensor]:
    """Linear samples of every component, (samples, N, H, W, 3); a regressor repeats its one estimate."""
    config = network.config
    count, _, height, width = batch.target.shape
    device = next(network.parameters()).device
    condition = batch.condition.to(device)
    if config.kind == "regressor":
        estimate = Conditioned(network).regress(condition)
        encoded = estimate.expand(samples, *estimate.shape)
    else:
        denoise = Conditioned(network).bind(condition)
        shape = (samples * count, config.output_channels, height, width)
        seeds = [seed * 1_000_003 + i for i in range(samples * count)]
        drawn = sample(denoise, config.noise_schedule, shape, seeds, SamplerSettings(steps=steps), device=device)
        encoded = drawn.reshape(samples, count, *shape[1:])
    found = {}
    for part, component in zip(encoded.cpu().split(3, 2), config.components, strict=True):
        found[component] = torch.stack([decode(component, one, batch.masks, batch.factor) for one in part])
    return found


def aligned_psnr(predicted: Tensor, truth: Tensor, inside: Tensor, *, channels: bool) -> Tensor:
    """PSNR (N,) of linear images (N, H, W, 3) inside (N, H, W), the prediction scaled to the truth's mean first.

    One factor per image, or one per channel. A black prediction keeps factor 1.
    """
    weight = inside[..., None].float()
    axes = (1, 2) if channels else (1, 2, 3)
    means = [(values * weight).sum(axes, keepdim=True) for values in (predicted, truth)]
    scale = torch.where(means[0] > 1e-6, means[1] / means[0].clamp_min(1e-6), 1.0)
    return psnr(predicted * scale, truth, inside)


def psnr(predicted: Tensor, truth: Tensor, inside: Tensor) -> Tensor:
    """PSNR (N,) in dB with peak 1 over the pixels inside (N, H, W) of (N, H, W, 3) images, at most 100; NaN where none is."""
    weight = inside[..., None].float()
    error = ((predicted - truth).square() * weight).sum((1, 2, 3)) / (3 * weight.sum((1, 2, 3)))
    return -10 * torch.log10(error.clamp_min(1e-10))
