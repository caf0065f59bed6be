"""``python -m ia_bench_baselines.yi.train``: trains the three networks on objects that are shown under several lights."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F
from torch.optim import Adam, Optimizer

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, Number, Rate, Weight
from ia_bench.priors.diffusion import encoding
from ia_bench_baselines.common.training import RunSettings, descend, initial_weights, masked_mean, run, training_command
from ia_bench_baselines.yi.data import LIGHTS, load_objects
from ia_bench_baselines.yi.networks import InverseRendering
from ia_bench_baselines.yi.shading import chromaticity, low_rank_loss, relative_distance

USAGE = """\
python -m ia_bench_baselines.yi.train data=FOLDER out=FOLDER [KEY=VALUE ...]

Trains on a folder that python -m ia_bench_baselines.yi.data made. The same command resumes a run that was stopped.

Settings and their defaults
"""


@dataclass(frozen=True)
class Settings(RunSettings):
    """What a training run of this method depends on.

    Attributes:
        supervised_steps: First steps, in which Spec-Net and Normal-Net learn from true specular shading and normals. The original
            starts from networks that were trained beforehand. The low-rank loss comes after them.
        objects: Objects of a step.
        rate: Adam's, of Normal-Net and Light-Net throughout, and of Spec-Net in the supervised steps.
        specular_rate: Adam's, of Spec-Net after the supervised steps.
        normal_weight: Of the normals' 1 - cosine beside the L1 of the specular shading, in the supervised steps.
        held_out: Objects at the end of the data on which the networks are validated, and not trained.
    """

    supervised_steps: Count = 2000
    objects: Number = 1
    rate: Rate = 1e-3
    specular_rate: Rate = 1e-6
    normal_weight: Weight = 0.5
    held_out: Number = 24


@dataclass(frozen=True)
class Pictures:
    """Pictures of one object under its lights, (B, C, S, S) in display values.

    Attributes:
        picture: What networks take: colour in [-1, 1] and the mask.
        image: Colour in [0, 1].
        specular: What must be taken from the image to leave the diffuse picture.
        normals: True ones, of unit length.
        mask: (B, 1, S, S), coverage.
    """

    picture: Tensor
    image: Tensor
    specular: Tensor
    normals: Tensor
    mask: Tensor


def encode(images: Mapping[str, Tensor]) -> Pictures:
    """The generator's linear tensors (B, S, S, C) as display pictures, each at an exposure of its own."""
    radiance, masks = images["image"][..., :3], images["image"][..., 3]
    factor = encoding.exposure(radiance, masks)
    picture = encoding.encode_image(radiance, masks, factor)
    matt = encoding.encode_image((radiance - images["specular"]).clamp_min(0), masks, factor)
    image, diffuse = ((0.5 + 0.5 * shown[:, :3]) * (masks[:, None] > 0) for shown in (picture, matt))
    normals = F.normalize(images["normal"].movedim(-1, 1), dim=1)
    return Pictures(picture, image, (image - diffuse).clamp_min(0), normals, masks[:, None])


class Training:
    """The networks and one Adam for each of the two rates."""

    def __init__(self, settings: Settings, objects: Mapping[str, Tensor]) -> None:
        count = len(objects["image"])
        if count <= settings.held_out:
            raise InputError(f"{settings.data}: expected more than held_out={settings.held_out} objects, found {count}")
        self.settings, self._objects, self._count = settings, objects, count - settings.held_out
        self._supervising = True
        initial_weights(settings.seed)
        self.networks = InverseRendering().to(settings.device)
        separating = Adam(self.networks.specular.parameters(), settings.rate, betas=(0.5, 0.999))
        decomposing = Adam([*self.networks.normal.parameters(), *self.networks.light.parameters()], settings.rate)
        self.optimisers: dict[str, Optimizer] = {"separating": separating, "decomposing": decomposing}

    def packaged(self) -> InverseRendering:
        """All three networks."""
        return self.networks

    def step(self, number: int, generator: torch.Generator) -> dict[str, float]:
        """Supervised at first, by low rank later."""
        supervised = self._supervising = number < self.settings.supervised_steps
        for group in self.optimisers["separating"].param_groups:
            group["lr"] = self.settings.rate if supervised else self.settings.specular_rate
        chosen = torch.randint(self._count, (self.settings.objects,), generator=generator).tolist()
        totals: list[Tensor] = []
        sums: dict[str, float] = {}
        for index in chosen:
            losses = self._supervised(self._shown(index)) if supervised else self._low_rank(self._shown(index))
            totals.append(torch.stack(list(losses.values())).sum() / len(chosen))
            for name, loss in losses.items():
                sums[name] = sums.get(name, 0.0) + float(loss.detach()) / len(chosen)
        descend(torch.stack(totals).sum(), *self.optimisers.values())
        return sums

    def validate(self) -> dict[str, float]:
        """Held-out objects: distance of their albedos from rank one as a share of their norm, and what else tells of collapse.

        The distance is the objective once the supervised steps are over; a light that is not trained yet is not worth keeping.
        """
        sums: dict[str, float] = {}
        for index in range(self._count, self._count + self.settings.held_out):
            shown = self._shown(index)
            specular = self.networks.separate(shown.picture)
            diffuse = (shown.image - specular).clamp(0, 1)
            albedo, normals, _ = self.networks.decompose(diffuse, shown.mask)
            inside = (shown.mask > 0).expand_as(albedo)
            figures = {
                "of the albedos": relative_distance(albedo.clamp(0, 1), shown.mask[0]),
                "of the images": relative_distance(shown.image, shown.mask[0]),
                "specular L1": masked_mean((specular - shown.specular).abs(), shown.mask),
                "normal 1 - cosine": masked_mean(1 - (normals * shown.normals).sum(1, keepdim=True), shown.mask),
                "clipped": (albedo[inside] >= 1).float().mean(),
            }
            for name, value in figures.items():
                sums[name] = sums.get(name, 0.0) + float(value) / self.settings.held_out
        return sums if self._supervising else {"objective": sums["of the albedos"], **sums}

    def _shown(self, index: int) -> Pictures:
        images = {name: values[index].to(self.settings.device).float() for name, values in self._objects.items()}
        return encode(images)

    def _supervised(self, shown: Pictures) -> dict[str, Tensor]:
        specular = self.networks.separate(shown.picture)
        _, normals, _ = self.networks.decompose((shown.image - shown.specular).clamp(0, 1), shown.mask)
        turned = masked_mean(1 - (normals * shown.normals).sum(1, keepdim=True), shown.mask)
        error = masked_mean((specular - shown.specular).abs(), shown.mask)
        return {"specular": error, "normal": self.settings.normal_weight * turned}

    def _low_rank(self, shown: Pictures) -> dict[str, Tensor]:
        """Of albedos for Normal-Net and Light-Net, of chromaticities of the diffuse picture for Spec-Net."""
        diffuse = shown.image - self.networks.separate(shown.picture)
        albedo, _, _ = self.networks.decompose(diffuse.detach().clamp(0, 1), shown.mask)
        mask = shown.mask[0]
        return {"albedo": low_rank_loss(albedo.clamp(0, 1), mask), "chromaticity": low_rank_loss(chromaticity(diffuse), mask)}


def train(settings: Settings, progress: Progress) -> dict[str, Any]:
    """Train (or go on training) and return the best validation figures."""
    objects = load_objects(settings.data)
    about = {"objects": len(objects["image"]) - settings.held_out, "lights": LIGHTS, "settings": settings.identity()}
    return run(Training(settings, objects), settings, about, progress)


if __name__ == "__main__":
    sys.exit(training_command(Settings, USAGE, train))
