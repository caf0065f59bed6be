"""``prior=refiner``: the regressor while a fit runs, and a network that corrects what the fit has recovered at its end.

The network is a small U-Net at full resolution that was trained on fits. Levels are divided out before it sees anything: of the
photograph by its mean, of the albedo by its own. So it can say nothing about how bright the whole object is painted, which
photographs of an unknown light do not tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ia_bench.common.errors import InputError
from ia_bench.priors.contract import Observations, Samples
from ia_bench.priors.diffusion.encoding import DARKEST, box_of
from ia_bench.priors.diffusion.learned import RegressorPrior, weights_folder
from ia_bench.priors.weight_files import fill, read_description
from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear

DESCRIPTION, WEIGHTS = "refiner.json", "refiner.safetensors"
WANTS = frozenset({"normals", "visibility", "view_count"})
FEATURES = 24
"""Channels of :func:`see`: photograph, albedo, specular shading, log shading, misfit, normal (3 each), evidence (2), roughness,
visibility, view_count, mask."""
RENDERS = {"albedo": 3, "roughness": 1, "radiance": 3, "specular": 3, "evidence": 2}
"""What :func:`see` is given of a fit, and how many channels each has."""
PHOTOGRAPH, ALBEDO = 0.3, 0.35
"""The photograph and the albedo are multiplied such that these are their means over the object."""
LARGEST_RADIANCE, LARGEST_ALBEDO = 8.0, 4.0
"""Values multiplied in this way are clipped here: larger ones are highlights and errors."""
OFFSET = 0.02
"""It is added to both sides of a quotient of which the network sees the logarithm, so that black has one."""
LEAST_COVERAGE = 0.02
"""Premultiplied values are divided by the coverage of their pixel, or by this where it is less."""
EMPTY = 0.02  # a pixel that the object covers no more than this shows nothing
SHADING_STOPS, SHADING_SCALE = 6, 0.3
"""The log2 of the shading is clipped to so many stops up and down, and multiplied so that it is about as large as the rest."""
VIEW_COUNT_SCALE = 6  # the log2 of 1 + view_count is divided by this: 63 photographs that show a place are a 1


@dataclass(kw_only=True, eq=False)
class RefinerPrior(RegressorPrior):
    """The regressor, and beside it a network that was trained on fits of procedural scenes.

    It sees a photograph, what the fit shows there (material, radiance, specular shading, and how well it explains several
    photographs of the place), normals, ambient visibility, and how many photographs show the place; it returns albedo and
    roughness as such fits have them when they are right. Those several are all photographs of the fit in training, and in a run
    those that the prior is asked about (with prior.views=auto about a third of a hundred, say).

    The fingerprint is that of the samples, on which the refiner's weights have no influence.

    Attributes:
        refiner: The network's weights, a folder that ia_bench_training.train_refiner wrote, or None for the packaged ones;
            ``weights`` are the regressor's.

    Raises:
        InputError: The weights cannot be used.
    """

    refiner: str | None = None

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[Path]:
        """The weights of both networks."""
        return [*super().files(options), weights_folder(options.get("refiner"), "refiner")]

    def __post_init__(self) -> None:
        super().__post_init__()
        self.info = replace(self.info, wants=WANTS)
        self._network = load_refiner(weights_folder(self.refiner, "refiner")).to(self._device)

    @torch.no_grad()
    def refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        """See :class:`ia_bench.priors.contract.Refiner`. A view without foreground, or an albedo that is black, stays as it is."""
        lacking = [name for name in RENDERS if name not in renders]
        lacking += [name for name in sorted(WANTS) if getattr(observations, name) is None]
        if lacking:
            raise InputError(f"prior=refiner: expected a fit's {' and '.join(lacking)} beside the images, found none")
        corrected = {name: renders[name].clone() for name in ("albedo", "roughness")}
        calls = 0
        for view in range(len(observations.masks)):
            inside = observations.masks[view] > EMPTY
            box = box_of(inside)
            if box is None or not bool((renders["albedo"][view][inside] > 0).any()):
                continue
            for images, values in zip(corrected.values(), self._corrected(observations, renders, view, box), strict=True):
                images[view][box] = values
            calls += 1
        return Samples(corrected, {}, {"network_calls": calls})

    def _corrected(
        self, observed: Observations, renders: Mapping[str, Tensor], view: int, box: tuple[slice, slice]
    ) -> tuple[Tensor, Tensor]:
        """Albedo (h, w, 3) and roughness (h, w, 1) of one view inside ``box``."""
        height, width = (side.stop - side.start for side in box)
        stride = self._network.config.stride

        def cut(images: Tensor) -> Tensor:
            inner = images[view][box].to(self._device)
            return F.pad(inner, (*(0, 0) * (inner.ndim - 2), 0, -width % stride, 0, -height % stride))[None]

        fitted = {name: cut(renders[name]) for name in RENDERS}
        geometry = {name: cut(getattr(observed, name)) for name in WANTS}  # refine() has made sure that there is all of it
        seen = see(cut(observed.images), cut(observed.masks), fitted, **geometry)
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self.bf16):
            change = self._network(seen.features)
        albedo, roughness = seen.corrected(change.float())
        return albedo[0, :height, :width].cpu(), roughness[0, :height, :width].cpu()


@dataclass(frozen=True)
class RefinerConfig:
    """``channels`` of each level of the network, from full resolution down; multiples of 8. Raises InputError."""

    channels: tuple[int, ...] = (32, 48, 64, 96)

    def __post_init__(self) -> None:
        if len(self.channels) < 2 or any(width < 8 or width % 8 for width in self.channels):
            raise InputError(f"network.channels: expected two or more multiples of 8, found {list(self.channels)}")

    @property
    def stride(self) -> int:
        """The sides of an image are multiples of this."""
        return 2 ** (len(self.channels) - 1)


@dataclass(frozen=True)
class Seen:
    """A fit as the network sees it.

    Attributes:
        features: (N, FEATURES, H, W), 0 where nothing is.
        albedo: (N, 3, H, W), the fit's, as on a display, at the mean ALBEDO, clipped at LARGEST_ALBEDO.
        beyond: (N, H, W, 3), by which the fit's is larger where it is clipped, else 1.
        factor: (N, 1, 1, 1), by which it was brought there.
        roughness: (N, 1, H, W), the fit's.
        mask: (N, H, W, 1), coverage.
    """

    features: Tensor
    albedo: Tensor
    beyond: Tensor
    factor: Tensor
    roughness: Tensor
    mask: Tensor

    def corrected(self, change: Tensor) -> tuple[Tensor, Tensor]:
        """Albedo (N, H, W, 3), linear, and roughness (N, H, W, 1), premultiplied.

        ``change`` (N, 4, H, W) is that of the albedo's display values and of the roughness. A photograph's mask may be less than
        what the fit covers, so that its straight roughness is above 1: limits hold for premultiplied ones.
        """
        albedo = srgb_to_linear((self.albedo + change[:, :3]).clamp_min(0)).movedim(1, -1) * self.beyond / self.factor
        roughness = (self.roughness + change[:, 3:]).movedim(1, -1) * self.mask
        return albedo * self.mask, roughness.clamp(0, 1)


def see(
    images: Tensor, masks: Tensor, renders: Mapping[str, Tensor], normals: Tensor, visibility: Tensor, view_count: Tensor
) -> Seen:
    """Photographs (N, H, W, 3) of ``masks`` (N, H, W) and what a fit renders there, all premultiplied and linear.

    ``renders`` are the RENDERS of a fit as in :meth:`ia_bench.priors.contract.Refiner.refine`; ``normals`` (N, H, W, 3),
    ``visibility`` and ``view_count`` (N, H, W, 1) as in :class:`ia_bench.priors.contract.Observations`.
    """
    albedo = renders["albedo"]
    mask = masks[..., None]
    straight = 1 / mask.clamp_min(LEAST_COVERAGE)
    inside = (mask > 0.5 * mask.amax((1, 2), keepdim=True)).float()
    level = _mean(images * straight, inside)
    exposure = torch.where(level > DARKEST, PHOTOGRAPH / level.clamp_min(DARKEST), 1.0)
    factor = ALBEDO / _mean(albedo * straight, inside).clamp_min(1e-4)
    photograph = (images * straight * exposure).clamp(0, LARGEST_RADIANCE)
    rendered = (renders["radiance"] * straight * exposure).clamp(0, LARGEST_RADIANCE)
    shine = (renders["specular"] * straight * exposure).clamp(0, LARGEST_RADIANCE)
    bright = (albedo * straight * factor).clamp_min(0)
    paint = bright.clamp_max(LARGEST_ALBEDO)
    stops = torch.log2(((photograph - shine).clamp_min(0) + OFFSET) / (paint + OFFSET))
    shading = stops.clamp(-SHADING_STOPS, SHADING_STOPS) * SHADING_SCALE
    misfit = torch.log2((photograph + OFFSET) / (rendered + OFFSET))
    shown, roughness = linear_to_srgb(paint), renders["roughness"] * straight
    evidence, counts = renders["evidence"] * straight, torch.log2(1 + view_count.clamp_min(0)) / VIEW_COUNT_SCALE
    colours = [linear_to_srgb(photograph), shown, linear_to_srgb(shine), shading, misfit]
    features = torch.cat([*colours, normals, evidence, roughness, visibility, counts, mask], -1) * (mask > EMPTY)
    first = [each.movedim(-1, 1).contiguous() for each in (features, shown, roughness)]
    return Seen(first[0], first[1], (bright / LARGEST_ALBEDO).clamp_min(1), factor, first[2], mask)


def _mean(values: Tensor, inside: Tensor) -> Tensor:
    """(N, 1, 1, 1): the mean of (N, H, W, 3) over pixels and channels; 0 where none is inside."""
    return ((values * inside).sum((1, 2, 3)) / (3 * inside.sum((1, 2, 3))).clamp_min(1))[:, None, None, None]


class RefinerNetwork(nn.Module):
    """A U-Net (Ronneberger et al. 2015) of residual blocks. Untrained it changes nothing."""

    def __init__(self, config: RefinerConfig) -> None:
        super().__init__()
        self.config = config
        widths = config.channels
        pairs = list(zip(widths, widths[1:], strict=False))
        self.conv_in = nn.Conv2d(FEATURES, widths[0], 3, padding=1)
        self.descending = nn.ModuleList([_Block(width) for width in widths[:-1]])
        self.coarser = nn.ModuleList([nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairs])
        self.lowest = nn.Sequential(_Block(widths[-1]), _Block(widths[-1]))
        self.finer = nn.ModuleList([nn.Conv2d(coarse, fine, 1) for fine, coarse in pairs])
        self.ascending = nn.ModuleList([_Block(width) for width in widths[:-1]])
        self.conv_out = nn.Conv2d(widths[0], 4, 1)
        nn.init.zeros_(self.conv_out.weight)
        nn.init.zeros_(self.conv_out.bias)  # type: ignore[arg-type]

    def forward(self, features: Tensor) -> Tensor:
        """The change (N, 4, H, W) of the albedo's display values and of the roughness, from features (N, FEATURES, H, W).

        Sides are multiples of the config's stride.
        """
        hidden, passed = self.conv_in(features), []
        for block, coarser in zip(self.descending, self.coarser, strict=True):
            hidden = block(hidden)
            passed.append(hidden)
            hidden = coarser(hidden)
        hidden = self.lowest(hidden)
        for level in reversed(range(len(passed))):
            up = F.interpolate(self.finer[level](hidden), scale_factor=2, mode="nearest")
            hidden = self.ascending[level](up + passed[level])
        change: Tensor = self.conv_out(hidden)
        return change


class _Block(nn.Module):
    """Two convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(8, width)
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, values: Tensor) -> Tensor:
        """(N, C, H, W) of the same."""
        changed: Tensor = values + self.second(F.silu(self.first(F.silu(self.norm(values)))))
        return changed


def load_refiner(folder: Path) -> RefinerNetwork:
    """The network in ``folder``, in float32 and evaluation mode. Raises InputError as :func:`ia_bench.priors.weight_files.fill`."""
    network = RefinerNetwork(read_description(folder / DESCRIPTION, RefinerConfig)[0])
    fill(network, folder / WEIGHTS)
    return network.eval().requires_grad_(False)
