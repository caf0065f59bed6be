"""Everything that a training run of a prior depends on, from KEY=VALUE arguments."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ia_bench.common.arguments import read_arguments
from ia_bench.common.errors import InputError
from ia_bench.common.suggestions import unknown
from ia_bench.common.typed import check_ranges
from ia_bench.priors.diffusion.network import NetworkConfig
from ia_bench.priors.diffusion.precision import PRECISIONS
from ia_bench.training.dataset import Augmentation

LIMITS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("steps", "batch", "threads", "validate_steps", "validation_images"), (1, math.inf)),
    **dict.fromkeys(("minutes", "checkpoint_minutes", "warmup"), (0, math.inf)),
    **dict.fromkeys(("rate", "muon_rate", "weight_decay", "clip_gradient"), (0, math.inf)),
    **dict.fromkeys(("ema", "background", "level"), (0, 1)),
    **dict.fromkeys(("augmentation.mirror", "augmentation.permute", "augmentation.no_geometry"), (0, 1)),
    **dict.fromkeys(("augmentation.cast", "augmentation.exposure", "augmentation.noise"), (0, math.inf)),
    "seed": (0, 2**32 - 1),  # validation multiplies it and stays within 64 bits
}
"""The least and the largest value of settings that are numbers."""


@dataclass(frozen=True)
class TrainSettings:
    """The settings of a training run.

    Attributes:
        data: Folder of shards to train on.
        validation: Folder of shards to validate on; its images have other seeds.
        out: The run's folder, in which a run resumes.
        init: Folder of weights to start from, also of the other kind (:mod:`ia_bench.training.warm_start`); None: random ones.
        steps: Optimiser steps in all; a run may go on with more.
        minutes: After so many the run stops and keeps its state; None for no limit.
        batch: Images a step, over all processes.
        rate: Full rate of AdamW. Rates rise over ``warmup`` steps and fall along a cosine to a fiftieth.
        muon_rate: Full rate of Muon on the hidden weights; with 0 AdamW has them too.
        warmup: Steps in which the rates rise.
        weight_decay: Of both optimisers.
        clip_gradient: Largest norm of the gradient; 0 for no limit.
        ema: Decay of the averaged weights, which are the ones that are kept.
        background: Weight in the loss of pixels outside the mask.
        level: Weight in the loss of an image's mean error. It is most of the error, and one image hardly tells it, because
            light and paint can share any colour.
        precision: "bf16", "float32", or "auto", which is bf16 where the processor has it.
        compile: Whether the network is compiled for training.
        threads: Of the CPU; None for torch's own choice.
        seed: Of every draw.
        checkpoint_minutes: How often the state is kept.
        validate_steps: Steps between two validations.
        validation_images: How many images a validation takes.
        validation_sampler_steps: Denoising steps of its samples.
        network: What is trained.
        augmentation: What is done to its images.
    """

    data: Path
    validation: Path
    out: Path
    init: Path | None = None
    steps: int = 20_000
    minutes: float | None = None
    batch: int = 32
    rate: float = 5e-4
    muon_rate: float = 0.02
    warmup: int = 200
    weight_decay: float = 0.01
    clip_gradient: float = 1.0
    ema: float = 0.999
    background: float = 0.1
    level: float = 0.25
    precision: str = "auto"
    compile: bool = True
    threads: int | None = None
    seed: int = 0
    checkpoint_minutes: float = 5.0
    validate_steps: int = 1000
    validation_images: int = 64
    validation_sampler_steps: int = 10
    network: NetworkConfig = field(default_factory=NetworkConfig)
    augmentation: Augmentation = field(default_factory=Augmentation)

    def identity(self) -> str:
        """Hash of what the weights depend on; a run resumes only where it is the same."""
        free = ("out", "steps", "minutes", "threads", "compile", "checkpoint_minutes")
        values = {
            key: value
            for key, value in dataclasses.asdict(self).items()
            if key not in free and not key.startswith("validat")
        }
        return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:16]


def parse(arguments: Sequence[str]) -> TrainSettings:
    """Read KEY=VALUE arguments; keys of the parts are dotted (network.size=128). Raises InputError naming the key."""
    settings = read_arguments(TrainSettings, arguments, "ia_bench.cli.train")
    steps = settings.network.timesteps if settings.network.kind == "diffusion" else math.inf
    check_ranges(settings, {**LIMITS, "validation_sampler_steps": (1, steps)})
    if settings.precision not in PRECISIONS:
        raise InputError(unknown("value of precision", settings.precision, PRECISIONS))
    return settings
