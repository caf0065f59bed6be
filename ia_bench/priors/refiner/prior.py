"""``prior=refiner``: the regressor while a fit runs, and a network that corrects what the fit has recovered at its end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as F

from ia_bench.common.errors import InputError
from ia_bench.common.ranges import Number
from ia_bench.priors.contract import Observations, Samples
from ia_bench.priors.inputs import Device, Precision, check_views
from ia_bench.priors.refiner.checkpoint import digest, load_refiner
from ia_bench.priors.refiner.network import LEAST, RefinerNetwork, see
from ia_bench.priors.regressor import RegressorPrior

VERSION = 1
"""Part of the fingerprint; raised when a change of the code changes what is corrected."""
WANTS = frozenset({"normals", "visibility", "sightings"})


class RefinerPrior(RegressorPrior):
    """The regressor, and beside it a network that was trained on fits of procedural scenes.

    It sees a photograph, what the fit shows there (albedo, specular shading), normals, ambient visibility, and how many
    photographs show the place; it returns the albedo as such fits have it when they are right. ``refiner``: its weights, a
    folder that ia_bench.cli.train_refiner wrote, or None for the packaged ones. Other options as in
    :class:`ia_bench.priors.learned.LearnedPrior`; ``weights`` are the regressor's.

    Raises InputError for weights that cannot be used.
    """

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
        self._corrections = Path(refiner).expanduser() if refiner else Path(str(files("ia_bench.priors") / "weights" / "refiner"))
        self._network: RefinerNetwork = load_refiner(self._corrections).to(self._device)

    @property
    def fingerprint(self) -> str:
        """See :class:`ia_bench.priors.contract.Fingerprinted`."""
        return json.dumps([super().fingerprint, VERSION, digest(self._corrections)])

    @torch.no_grad()
    def refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        """See :class:`ia_bench.priors.contract.Refiner`. A view without foreground, or an albedo that is black, stays as it is."""
        check_views("refiner", observations, renders, ("albedo", "specular"))
        lacking = [name for name in ("albedo", "specular") if name not in renders]
        lacking += [name for name in sorted(WANTS) if getattr(observations, name) is None]
        if lacking:
            raise InputError(f"prior=refiner: expected a fit's {' and '.join(lacking)} beside the images, found none")
        corrected = renders["albedo"].clone()
        calls = 0
        for view in range(len(corrected)):
            box = self._box(observations.masks[view], renders["albedo"][view])
            if box is None:
                continue
            corrected[view][box] = self._corrected(observations, renders, view, box)
            calls += 1
        return Samples({"albedo": corrected}, {}, {"network_calls": calls})

    def _corrected(self, observed: Observations, renders: Mapping[str, Tensor], view: int, box: tuple[slice, slice]) -> Tensor:
        """The albedo (h, w, 3) of one view inside ``box``."""
        every = (observed.normals, observed.visibility, observed.sightings)
        geometry = [tensor for tensor in every if tensor is not None]  # all of them, as refine() has made sure
        maps = (observed.images, observed.masks, renders["albedo"], renders["specular"], *geometry)
        height, width = (side.stop - side.start for side in box)
        stride = self._network.config.stride
        cut = [_padded(each[view][box].to(self._device), -height % stride, -width % stride) for each in maps]
        seen = see(*(each[None] for each in cut))
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self.bf16):
            change = self._network(seen.features)
        return seen.corrected(change.float())[0, :height, :width].cpu()

    @staticmethod
    def _box(mask: Tensor, albedo: Tensor) -> tuple[slice, slice] | None:
        """Rows and columns of the foreground; None where there is none, or nothing of it has an albedo."""
        inside = mask > LEAST
        if not bool((albedo[inside] > 0).any()):
            return None
        rows, columns = (torch.nonzero(inside.any(axis))[:, 0] for axis in (1, 0))
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _padded(values: Tensor, below: int, right: int) -> Tensor:
    """(H, W) or (H, W, C) with zeros below and to the right."""
    return F.pad(values, (*(0, 0) * (values.ndim - 2), 0, right, 0, below))
