"""``prior=refiner``: the regressor while a fit runs, and a network that corrects what the fit has recovered at its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from ia_bench.common.errors import InputError
from ia_bench.common.ranges import Number
from ia_bench.priors.contract import Observations, Samples
from ia_bench.priors.diffusion.learned import weights_folder
from ia_bench.priors.inputs import Device, Precision, check_views
from ia_bench.priors.refiner.checkpoint import load_refiner
from ia_bench.priors.refiner.network import EMPTY, RENDERS, RefinerNetwork, see
from ia_bench.priors.regressor import RegressorPrior

WANTS = frozenset({"normals", "visibility", "view_count"})


class RefinerPrior(RegressorPrior):
    """The regressor, and beside it a network that was trained on fits of procedural scenes.

    It sees a photograph, what the fit shows there (material, radiance, specular shading, and how well it explains several
    photographs of the place), normals, ambient visibility, and how many photographs show the place; it returns albedo and
    roughness as such fits have them when they are right. Those several are all photographs of the fit in training, and in a run
    those that the prior is asked about (with prior.views=auto about a third of a hundred, say).

    ``refiner``: its weights, a folder that ia_bench_training.train_refiner wrote, or None for the packaged ones. Other options as
    in :class:`ia_bench.priors.diffusion.learned.LearnedPrior`; ``weights`` are the regressor's. The fingerprint
    is that of the samples, on which the refiner's weights have no influence.

    Raises InputError for weights that cannot be used.
    """

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[Path]:
        """The weights of both networks."""
        return [*super().files(options), weights_folder(options.get("refiner"), "refiner")]

    def __init__(
        self,
        *,
        weights: str | None = None,
        refiner: str | None = None,
        geometry: bool = False,
        batch: Number = 64,
        precision: Precision = "auto",
        device: Device = "auto",
    ) -> None:
        super().__init__(weights=weights, geometry=geometry, batch=batch, precision=precision, device=device)
        self.info = replace(self.info, wants=WANTS)
        self._network: RefinerNetwork = load_refiner(weights_folder(refiner, "refiner")).to(self._device)

    @torch.no_grad()
    def refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        """See :class:`ia_bench.priors.contract.Refiner`. A view without foreground, or an albedo that is black, stays as it is."""
        check_views("refiner", observations, renders, RENDERS, RENDERS, what="fitted")
        lacking = [name for name in RENDERS if name not in renders]
        lacking += [name for name in sorted(WANTS) if getattr(observations, name) is None]
        if lacking:
            raise InputError(f"prior=refiner: expected a fit's {' and '.join(lacking)} beside the images, found none")
        corrected = {name: renders[name].clone() for name in ("albedo", "roughness")}
        calls = 0
        for view in range(len(observations.masks)):
            box = self._box(observations.masks[view], renders["albedo"][view])
            if box is None:
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
            return _padded(images[view][box].to(self._device), -height % stride, -width % stride)[None]

        fitted = {name: cut(renders[name]) for name in RENDERS}
        geometry = {name: cut(getattr(observed, name)) for name in WANTS}  # refine() has made sure that there is all of it
        seen = see(cut(observed.images), cut(observed.masks), fitted, **geometry)
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self.bf16):
            change = self._network(seen.features)
        albedo, roughness = (maps[0, :height, :width].cpu() for maps in seen.corrected(change.float()))
        return albedo, roughness

    @staticmethod
    def _box(mask: Tensor, albedo: Tensor) -> tuple[slice, slice] | None:
        """Rows and columns of the foreground; None where there is none, or nothing of it has an albedo."""
        inside = mask > EMPTY
        if not bool((albedo[inside] > 0).any()):
            return None
        rows, columns = (torch.nonzero(inside.any(axis))[:, 0] for axis in (1, 0))
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _padded(values: Tensor, below: int, right: int) -> Tensor:
    """(H, W) or (H, W, C) with zeros below and to the right."""
    return F.pad(values, (*(0, 0) * (values.ndim - 2), 0, right, 0, below))
