"""Images larger than the network's native size: one coarse sample, then overlapping patches drawn to it (equation 6).

Each patch x is sampled at full resolution while |G(x_0) - coarse|, G a Gaussian blur, pulls its low frequencies to those of
the coarse sample; patches are then averaged under a Hann window. Independent patches would be blurred where they overlap (an
average of n independent details has 1 / n of their energy), so all patches of an image see windows of one noise image, at the
start and after each step: where the network sees the same, it draws the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.seeds import derive_seed
from ia_bench.priors.diffusion.guidance import DEFAULT_PRIOR_VARIANCE, Guidance, GuidanceReport, Norm, Pull, Rule
from ia_bench.priors.diffusion.operators import GaussianBlur
from ia_bench.priors.diffusion.sampler import Noise, SamplerSettings, sample, seeded_noise
from ia_bench.priors.diffusion.schedule import Denoise, NoiseSchedule

MakeDenoise = Callable[[Tensor], Denoise]
"""Conditions (n, C, native, native) -> the denoiser bound to them, for n samples at once."""

Place = tuple[int, slice, slice, slice]
"""Where a patch lies: (image, all channels, rows, columns), an index into (N, C, H, W)."""


PATCH_REDUCTION = 3.0
"""Image pixels a native pixel may stand for before patches are worth their cost: up to 2.9 single views gain nothing."""


@dataclass(frozen=True, eq=False)
class PatchSettings:
    """``overlap``: least share of a patch's side that its neighbour covers too, [0, 0.9]; ``batch``: samples at once.

    ``strength``, ``rule``, ``norm``, ``prior_variance``: how the coarse sample guides the patches (see guidance.py; strength
    0: not at all). ``blur``: standard deviation of G in full-resolution pixels; None takes half the reduction factor, which
    is what averaging over a coarse pixel and interpolating linearly between coarse pixels amount to: variances factor^2 / 12
    and factor^2 / 6.
    """

    overlap: float = 0.5
    strength: float = 100.0
    rule: Rule = "variance"
    norm: Norm = "squared"
    prior_variance: float = DEFAULT_PRIOR_VARIANCE
    blur: float | None = None
    batch: int = 64


@dataclass(frozen=True, eq=False)
class _Job:
    """What every batch of one call has in common: network, schedule, size, sampler, and the manner of guidance."""

    make_denoise: MakeDenoise
    schedule: NoiseSchedule
    channels: int
    native: int
    settings: SamplerSettings
    patches: PatchSettings
    manner: Guidance | PatchSettings
    report: GuidanceReport

    def sample(self, condition: Tensor, seeds: Sequence[int] | Noise, pulls: Sequence[Pull]) -> Tensor:
        """Samples (n, channels, native, native) for ``condition`` (n, C, native, native), toward ``pulls``."""
        how = self.manner
        guidance = Guidance.of(pulls, how.rule, how.norm, how.prior_variance, self.report) if pulls else None
        shape = len(condition), self.channels, self.native, self.native
        denoise, device, dtype = self.make_denoise(condition), condition.device, condition.dtype
        return sample(denoise, self.schedule, shape, seeds, self.settings, guidance, device=device, dtype=dtype)


def sample_large(
    make_denoise: MakeDenoise,
    schedule: NoiseSchedule,
    condition: Tensor,
    native: int,
    *,
    channels: int,
    seeds: Sequence[int],
    settings: SamplerSettings,
    patches: PatchSettings | None = None,
    foreground: Tensor | None = None,
    guidance: Guidance | None = None,
    report: GuidanceReport | None = None,
) -> Tensor:
    """One sample (N, ``channels``, H, W) per ``condition`` (N, C, H, W), of any size, on the condition's device.

    ``native`` is the side of the squares that the network works on. An image is padded to at least that by repeating its
    edge, and cropped in the end. If it is larger, it is padded to a square and reduced to ``native`` for the coarse sample,
    then sampled in patches at full resolution; patches without ``foreground`` ((N, 1, H, W), > 0 where it matters; None:
    everywhere) are skipped, and what no patch covers keeps the enlarged coarse sample.

    ``guidance`` (at full resolution) guides the coarse sample, reduced, and the patches beside the coarse one; its rule,
    norm, prior variance and report then hold for both. Without it ``report``, if given, counts what the coarse one did.
    ``seeds`` (N,): the coarse sample's seed is the image's, that of the noise its patches share derives from it, so that an
    image's sample depends neither on the images beside it nor on ``patches.batch``. Raises InputError where sizes do not
    match.
    """
    if condition.ndim != 4 or len(seeds) != len(condition):
        raise InputError(f"condition: expected (N, C, H, W) with N = {len(seeds)} seeds, found {tuple(condition.shape)}")
    expected = len(condition), 1, *condition.shape[2:]
    if foreground is not None and tuple(foreground.shape) != expected:
        raise InputError(f"foreground: expected shape {expected}, found {tuple(foreground.shape)}")
    patches = patches or PatchSettings()
    if guidance is not None and not guidance.active:
        guidance = None
    counts = guidance.report if guidance is not None else report or GuidanceReport()
    job = _Job(make_denoise, schedule, channels, native, settings, patches, guidance or patches, counts)
    pulls = () if guidance is None else guidance.pulls

    height, width = condition.shape[-2:]
    outer = max(height, native), max(width, native)
    coarse = _sample_coarse(job, condition, seeds, pulls, outer)
    if max(outer) > native:
        foreground = torch.ones(expected) if foreground is None else foreground.float().cpu()
        padded = [pull.through(partial(_pad, size=outer)) for pull in pulls]
        coarse = _sample_fine(job, _pad(condition, outer), coarse, _pad(foreground, outer), seeds, padded)
    return _crop(coarse, (height, width))


def _sample_coarse(job: _Job, condition: Tensor, seeds: Sequence[int], pulls: Sequence[Pull], outer: tuple[int, int]) -> Tensor:
    """The coarse samples, enlarged to ``outer`` (at native size as they are)."""
    side, small = max(outer), (job.native, job.native)

    def reduced(image: Tensor, part: slice) -> Tensor:
        return _resized(_pad(image[part], (side, side)), small)

    samples = []
    for start in range(0, len(condition), job.patches.batch):
        part = slice(start, start + job.patches.batch)
        toward = [pull.through(partial(reduced, part=part), job.native / side) for pull in pulls]
        samples.append(job.sample(reduced(condition, part), seeds[part], toward))
    return _crop(_resized(torch.cat(samples), (side, side)), outer)


def _sample_fine(
    job: _Job, condition: Tensor, coarse: Tensor, foreground: Tensor, seeds: Sequence[int], pulls: Sequence[Pull]
) -> Tensor:
    """The feathered average of all patches, the size of ``condition``; ``coarse`` where no patch lies."""
    native, (height, width) = job.native, condition.shape[-2:]
    factor = max(height, width) / native
    blur = GaussianBlur(factor / 2 if job.patches.blur is None else job.patches.blur)
    pulls = [Pull(coarse, job.patches.strength, operator=blur), *pulls]
    places = [
        (number, slice(None), slice(top, top + native), slice(left, left + native))
        for number in range(len(condition))
        for top, left in patch_origins(height, width, native, job.patches.overlap)
        if foreground[number, 0, top : top + native, left : left + native].any()
    ]

    window = hann_window(native).to(condition.device)
    total = torch.zeros_like(coarse, dtype=torch.float64)
    weight = torch.zeros_like(coarse[:, :1], dtype=torch.float64)
    for start in range(0, len(places), job.patches.batch):
        part = places[start : start + job.patches.batch]
        cut = partial(_cut, places=part)
        noise = _shared_noise(part, seeds, (job.channels, height, width))
        fine = job.sample(cut(condition), noise, [pull.through(cut) for pull in pulls])
        for place, patch in zip(part, fine, strict=True):
            total[place] += window * patch
            weight[place] += window
    return torch.where(weight > 0, total / weight, coarse).to(coarse.dtype)


def _cut(images: Tensor, places: Sequence[Place]) -> Tensor:
    """The patches of ``images`` (N, C, H, W) at ``places``, (n, C, native, native)."""
    return torch.stack([images[place] for place in places])


def _shared_noise(places: Sequence[Place], seeds: Sequence[int], shape: tuple[int, int, int]) -> Noise:
    """Noise for the patches at ``places``: windows of a noise image ``shape`` (C, H, W) for each image that they lie in."""
    numbers = sorted({number for number, *_ in places})
    images = seeded_noise([derive_seed(seeds[number], 0) for number in numbers], shape)
    local = [(numbers.index(number), every, rows, columns) for number, every, rows, columns in places]
    return lambda: _cut(images(), local)


def patch_origins(height: int, width: int, native: int, overlap: float) -> Iterator[tuple[int, int]]:
    """(top, left) of the ``native`` squares that cover ``height`` x ``width`` (each >= ``native``), row by row.

    As few as leave neighbours at least ``overlap`` of a side in common, spread evenly from edge to edge.
    """

    def starts(size: int) -> list[int]:
        gaps = math.ceil((size - native) / max(1, math.floor(native * (1 - overlap))))
        return [round(i * (size - native) / gaps) for i in range(gaps)] + [size - native]

    return ((top, left) for top in starts(height) for left in starts(width))


def hann_window(native: int) -> Tensor:
    """(native, native) float64, sin^2 along each axis: positive in every pixel, zero with zero slope just outside.

    In double precision, so that an average of equal values returns them to the last bit of single precision.
    """
    profile = torch.sin(math.pi / native * (torch.arange(native, dtype=torch.float64) + 0.5)).square()
    return profile[:, None] * profile


def _pad(image: Tensor, size: tuple[int, int]) -> Tensor:
    """``image`` (N, C, H, W) in the middle of ``size``, its edge repeated around it."""
    below, right = size[0] - image.shape[-2], size[1] - image.shape[-1]
    return F.pad(image, (right // 2, right - right // 2, below // 2, below - below // 2), mode="replicate")


def _crop(image: Tensor, size: tuple[int, int]) -> Tensor:
    """The middle of ``image`` that :func:`_pad` put there."""
    top, left = (image.shape[-2] - size[0]) // 2, (image.shape[-1] - size[1]) // 2
    return image[..., top : top + size[0], left : left + size[1]]


def _resized(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Bilinear, averaging where it reduces; an image that has the size comes back as it is."""
    if image.shape[-2:] == size:
        return image
    return F.interpolate(image, size, mode="bilinear", align_corners=False, antialias=True)
