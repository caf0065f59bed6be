"""Square images larger than the network's native size: one coarse sample, then overlapping patches drawn to it (equation 6).

Each patch x is sampled at full resolution while |G(x_0) - coarse|, G a Gaussian blur, pulls its low frequencies to those of
the coarse sample; patches are then averaged under a Hann window. Independent patches would be blurred where they overlap (an
average of n independent details has 1 / n of their energy), so all patches of an image see windows of one noise image, at the
start and after each step: where the network sees the same, it draws the same.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.priors.diffusion.guidance import Guidance, Pull
from ia_bench.priors.diffusion.sampler import Denoise, Noise, NoiseSchedule, SamplerSettings, sample, seeded_noise

MakeDenoise = Callable[[Tensor], Denoise]
"""Conditions (n, C, native, native) -> the denoiser bound to them, for n samples at once."""

Place = tuple[int, slice, slice, slice]
"""Where a patch lies: (image, all channels, rows, columns), an index into (N, C, H, W)."""

OVERLAP = 0.5  # least share of a patch's side that its neighbour covers too
STRENGTH = {"squared": 100.0, "l2": 3.0}
"""How strongly the coarse sample guides the patches, by the norm of guidance.py; of "l2" the authors recommend 2 to 5."""


def sample_large(
    make_denoise: MakeDenoise,
    schedule: NoiseSchedule,
    like: tuple[int, int, int],
    condition: Tensor,
    foreground: Tensor,
    seeds: Sequence[int],
    settings: SamplerSettings,
    guidance: Guidance,
    *,
    batch: int,
) -> Tensor:
    """One sample (N, channels, S, S) per ``condition`` (N, C, S, S), on its device, ``batch`` images or patches at a time.

    ``like`` is the shape of what the network draws, smaller than S: an image is reduced to that for the coarse sample, then
    sampled in patches at full resolution. Patches without ``foreground`` ((N, 1, S, S) on the CPU, > 0 where it matters) are
    skipped; what no patch covers keeps the enlarged coarse sample. The pulls of ``guidance`` (at full resolution) act on the
    coarse sample, reduced, and on the patches beside the coarse one. ``seeds`` (N,): the coarse sample's seed is the image's,
    that of the noise its patches share derives from it, so that an image's sample depends neither on the images beside it nor
    on the batch.
    """
    channels, native, _ = like
    side = condition.shape[-1]

    def draw(condition: Tensor, seeds: Sequence[int] | Noise, pulls: Sequence[Pull]) -> Tensor:
        counted = guidance.cost if guidance.pulls else Counter[str]()  # what the coarse sample does is no guidance of a run
        denoise = replace(guidance, pulls=tuple(pulls), cost=counted).guiding(make_denoise(condition), schedule)
        shape, device, dtype = (len(condition), *like), condition.device, condition.dtype
        return sample(denoise, schedule, shape, seeds, settings, device=device, dtype=dtype)

    def shared_noise(places: Sequence[Place]) -> Noise:
        """Windows of one noise image for each image that patches lie in."""
        numbers = sorted({number for number, *_ in places})
        images = seeded_noise([derive_seed(seeds[number], 0) for number in numbers], (channels, side, side))
        windows = [(numbers.index(number), every, rows, columns) for number, every, rows, columns in places]
        return lambda: _cut(images(), windows)

    samples = []
    for start in range(0, len(condition), batch):
        part = slice(start, start + batch)

        def reduced(images: Tensor, part: slice = part) -> Tensor:
            return _resized(images[part], native)

        toward = [pull.through(reduced, native / side) for pull in guidance.pulls]
        samples.append(draw(reduced(condition), seeds[part], toward))
    coarse = _resized(torch.cat(samples), side)
    # To average over a coarse pixel (variance factor^2 / 12) and interpolate linearly between them (factor^2 / 6) is nearly:
    pulls = [Pull(coarse, STRENGTH[guidance.norm], sigma=side / native / 2), *guidance.pulls]
    places = [
        (number, slice(None), slice(top, top + native), slice(left, left + native))
        for number in range(len(condition))
        for top, left in patch_origins(side, native)
        if foreground[number, 0, top : top + native, left : left + native].any()
    ]
    # Hann, in double precision, so that an average of equal values returns them to the last bit of single precision.
    profile = torch.sin(math.pi / native * (torch.arange(native, dtype=torch.float64) + 0.5)).square().to(condition.device)
    window = profile[:, None] * profile
    total = torch.zeros_like(coarse, dtype=torch.float64)
    weight = torch.zeros_like(coarse[:, :1], dtype=torch.float64)
    for start in range(0, len(places), batch):
        some = places[start : start + batch]
        cut = partial(_cut, places=some)
        fine = draw(cut(condition), shared_noise(some), [pull.through(cut) for pull in pulls])
        for place, patch in zip(some, fine, strict=True):
            total[place] += window * patch
            weight[place] += window
    return torch.where(weight > 0, total / weight, coarse).to(coarse.dtype)


def _cut(images: Tensor, places: Sequence[Place]) -> Tensor:
    """The patches of ``images`` (N, C, H, W) at ``places``, (n, C, native, native)."""
    return torch.stack([images[place] for place in places])


def patch_origins(side: int, native: int) -> Iterator[tuple[int, int]]:
    """(top, left) of the ``native`` squares that cover a square of ``side`` pixels, which is no smaller, row by row.

    As few as leave neighbours at least OVERLAP of a side in common, spread evenly from edge to edge.
    """
    gaps = math.ceil((side - native) / max(1, math.floor(native * (1 - OVERLAP))))
    starts = [round(i * (side - native) / gaps) for i in range(gaps)] + [side - native]
    return itertools.product(starts, starts)


def _resized(image: Tensor, side: int) -> Tensor:
    """Squares of ``side`` pixels: bilinear, averaging where it reduces."""
    return F.interpolate(image, (side, side), mode="bilinear", align_corners=False, antialias=True)
