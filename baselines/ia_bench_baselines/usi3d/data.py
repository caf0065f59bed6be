"""Unpaired pictures of three domains from one folder of the generator's images: other objects in each domain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.priors.diffusion import encoding
from ia_bench.scenes.images import straight
from ia_bench_baselines.common.pictures import SIDE
from ia_bench_training.dataset import TrainingImages
from ia_bench_training.render import VIEWS

DOMAINS = ("image", "albedo", "shading")
BRIGHTEST = 1.0  # linear, to which the 0.9 quantile of an albedo is scaled: only ratios are learned
DARKEST_PAINT = 0.01  # below which a shading is not told from what the pixel shows


def domain_pictures(domain: str, images: Mapping[str, Tensor]) -> Tensor:
    """Pictures (N, 4, S, S) of one domain from the generator's linear tensors (N, S, S, C).

    Images are exposed as for the prior, shadings (diffuse radiance over albedo) likewise. An albedo is scaled so that its brightest
    paints are white: then image, albedo and shading are about as bright as the physical loss wants them.
    """
    radiance, masks = images["image"][..., :3], images["image"][..., 3]
    if domain == "albedo":
        radiance = images["albedo"]
    elif domain == "shading":
        paint = straight(images["albedo"], masks, encoding.FAINTEST)
        radiance = (radiance - images["specular"]).clamp_min(0) / paint.clamp_min(DARKEST_PAINT)
    factor = encoding.exposure(radiance, masks)
    if domain == "albedo":
        factor = factor * (BRIGHTEST / encoding.EXPOSED_VALUE)
    return encoding.encode_image(radiance, masks, factor)


class UnpairedImages:
    """A folder cut into three ranges of whole objects, one for each domain, and held-out images of the first range."""

    def __init__(self, folder: Path, held_out: int) -> None:
        images = TrainingImages(folder)
        share = len(images) // (len(DOMAINS) * VIEWS) * VIEWS
        if images.size != SIDE or share <= held_out:
            least = len(DOMAINS) * (held_out // VIEWS + 1) * VIEWS
            found = f"{len(images)} of {images.size}"
            raise InputError(f"{folder}: expected at least {least} images of {SIDE} pixels, found {found}")
        self._images = images
        self._ranges = {name: range(k * share, (k + 1) * share) for k, name in enumerate(DOMAINS)}
        self._held_out = self._ranges["image"][share - held_out :]
        self._ranges["image"] = self._ranges["image"][: share - held_out]

    def __len__(self) -> int:
        return sum(len(numbers) for numbers in self._ranges.values())

    def draw(self, domain: str, count: int, generator: torch.Generator) -> Tensor:
        """Random pictures (N, 4, S, S) of a domain, mirrored at random."""
        numbers = self._ranges[domain]
        index = torch.tensor(numbers)[torch.randint(len(numbers), (count,), generator=generator)]
        pictures = domain_pictures(domain, self._images.linear(index))
        mirrored = torch.rand(count, generator=generator) < 0.5
        return torch.where(mirrored[:, None, None, None], pictures.flip(3), pictures)

    def held_out(self) -> Tensor:
        """Images that are never trained on."""
        return domain_pictures("image", self._images.linear(torch.tensor(self._held_out)))
