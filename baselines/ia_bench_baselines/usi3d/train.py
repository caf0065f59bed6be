"""``python -m ia_bench_baselines.usi3d.train``: trains the three auto-encoders against two discriminators, without pairs."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from ia_bench.common.progress import Progress
from ia_bench.common.ranges import NotNegative, Number, Rate
from ia_bench_baselines.common.training import RunSettings, descend, initial_weights, run, training_command
from ia_bench_baselines.usi3d.data import UnpairedImages
from ia_bench_baselines.usi3d.losses import Domains, Weights, discriminator_loss, generator_losses, toward, translate
from ia_bench_baselines.usi3d.networks import STYLE, AlbedoPath, Discriminator, ThreeDomains

USAGE = """\
python -m ia_bench_baselines.usi3d.train data=FOLDER out=FOLDER [KEY=VALUE ...]

Trains on a folder that python -m ia_bench_training.prior_data made: the first third of its images, the albedos of the second, the
shadings of the last. The same command resumes a run that was stopped.

Settings and their defaults
"""


@dataclass(frozen=True)
class Settings(RunSettings):
    """What a training run of this method depends on.

    Attributes:
        batch: Pictures of each domain in a step.
        rate: Adam's (betas .5 and .999), halved every ``halve_steps``.
        halve_steps: Steps between two halvings of the rate.
        weight_decay: Adam's.
        style_shift: Mean of the random styles of albedos, and minus that of shadings; their deviation is 1.
        held_out: Images on which the generators are validated, and not trained.
        weights: Of the generators' losses.
    """

    batch: Number = 4
    rate: Rate = 1e-4
    halve_steps: Number = 100_000
    weight_decay: NotNegative = 1e-4
    style_shift: NotNegative = 10.0
    held_out: Number = 32
    weights: Weights = field(default_factory=Weights)


class Networks(nn.Module):
    """Generators and discriminators, which are kept together in a checkpoint."""

    def __init__(self) -> None:
        super().__init__()
        self.domains = ThreeDomains()
        self.albedo_judge, self.shading_judge = Discriminator(), Discriminator()
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d | nn.Linear):
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
                if layer.bias is not None:
                    nn.init.zeros_(layer.bias)

    def judges(self) -> list[nn.Parameter]:
        """Weights of the discriminators."""
        return [*self.albedo_judge.parameters(), *self.shading_judge.parameters()]


class Training:
    """Generators and discriminators, each side with an Adam of its own."""

    def __init__(self, settings: Settings, images: UnpairedImages) -> None:
        self.settings, self._images = settings, images
        initial_weights(settings.seed)
        self.networks = Networks().to(settings.device)
        sides = {"generators": list(self.networks.domains.parameters()), "discriminators": self.networks.judges()}
        decay = settings.weight_decay
        self.optimisers: dict[str, Optimizer] = {
            name: Adam(weights, settings.rate, betas=(0.5, 0.999), weight_decay=decay) for name, weights in sides.items()
        }

    def packaged(self) -> AlbedoPath:
        """The way from an image to its albedo."""
        return AlbedoPath(self.networks.domains)

    def step(self, number: int, generator: torch.Generator) -> dict[str, float]:
        """Discriminators first, then generators, on the same pictures."""
        for optimiser in self.optimisers.values():
            for group in optimiser.param_groups:
                group["lr"] = self.settings.rate * 0.5 ** (number // self.settings.halve_steps)
        shown, networks = self._draw(generator), self.networks
        made = translate(networks.domains, shown)
        judged = {
            "albedo": (networks.albedo_judge, shown.albedo, (made.of_image.albedo, made.albedo)),
            "shading": (networks.shading_judge, shown.shading, (made.of_image.shading, made.shading)),
        }

        # ---------------------------------------------------------------- discriminators
        told = torch.stack([discriminator_loss(*sides) for sides in judged.values()]).sum()
        descend(self.settings.weights.adversarial * told, self.optimisers["discriminators"])

        # ---------------------------------------------------------------- generators, against the judges of now
        losses = generator_losses(networks.domains, networks.albedo_judge, networks.shading_judge, shown, made)
        weights = dataclasses.asdict(self.settings.weights)
        descend(torch.stack([weights[name] * loss for name, loss in losses.items()]).sum(), self.optimisers["generators"])
        return {"discriminators": float(told.detach()), **{name: float(loss.detach()) for name, loss in losses.items()}}

    def validate(self) -> dict[str, float]:
        """The generators' losses on held-out images, with fixed pictures of the other domains.

        The objective is their weighted sum without the adversarial part: a discriminator gets better while it is trained, so that
        its verdicts of two times cannot be compared.
        """
        fixed = torch.Generator().manual_seed(self.settings.seed)
        image = self._images.held_out().to(self.settings.device)
        shown = dataclasses.replace(self._draw(fixed, len(image)), image=image)
        networks = self.networks
        made = translate(networks.domains, shown)
        losses = generator_losses(networks.domains, networks.albedo_judge, networks.shading_judge, shown, made)
        weights = dataclasses.asdict(self.settings.weights)
        total = sum(weights[name] * float(loss) for name, loss in losses.items() if name != "adversarial")
        verdict = float(toward(networks.albedo_judge(made.of_image.albedo), 1))
        return {"objective": total, "albedo verdict": verdict, **{name: float(loss) for name, loss in losses.items()}}

    def _draw(self, generator: torch.Generator, count: int | None = None) -> Domains:
        number, shift = self.settings.batch if count is None else count, self.settings.style_shift
        image, albedo, shading = (self._images.draw(name, number, generator) for name in ("image", "albedo", "shading"))
        styles = (sign * shift + torch.randn(number, STYLE, generator=generator) for sign in (1, -1))
        tensors: list[Tensor] = [image, albedo, shading, *styles]
        return Domains(*(tensor.to(self.settings.device) for tensor in tensors))


def train(settings: Settings, progress: Progress) -> dict[str, Any]:
    """Train (or go on training) and return the best validation figures."""
    images = UnpairedImages(settings.data, settings.held_out)
    about = {"pictures": len(images), "settings": settings.identity()}
    return run(Training(settings, images), settings, about, progress)


if __name__ == "__main__":
    sys.exit(training_command(Settings, USAGE, train))
