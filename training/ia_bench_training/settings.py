"""Everything that a training run of a prior depends on, from KEY=VALUE arguments."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ia_bench.common.errors import InputError
from ia_bench.common.ranges import Count, NotNegative, Number, UnitInterval
from ia_bench.priors.diffusion.network import NetworkConfig
from ia_bench_training.dataset import Augmentation
from ia_bench_training.resuming import identity
from ia_bench_training.world.images import Mixture


@dataclass(frozen=True)
class TrainSettings:
    """The settings of a training run.

    Attributes:
        data: Folder of shards to train on, or of a world (ia_bench_training.world.make), whose images are made on the way.
        mixture: Which share of what a world holds is real.
        validation: Folder of shards to validate on; its images have other seeds.
        scenes: Development scenes whose test views are scored beside it, as names or folders.
        out: The run's folder, in which a run resumes.
        init: Folder of weights of the same network to start from; None: random ones.
        steps: Optimiser steps in all; a run may go on with more.
        minutes: After so many the run stops and keeps its state; None for no limit.
        batch: Images a step, over all processes.
        rate: Full rate of AdamW. Rates rise over ``warmup`` steps and fall along a cosine to a fiftieth.
        muon_rate: Full rate of Muon on the hidden weights; with 0 AdamW has them too.
        warmup: Steps in which the rates rise.
        weight_decay: Weight decay of both optimisers.
        clip_gradient: Largest norm of the gradient; 0 for no limit.
        ema: Decay of the averaged weights, which are the ones that are kept.
        background: Weight in the loss of pixels outside the mask.
        level: Weight in the loss of an image's mean error. It is most of the error, and one image hardly tells it, because
            light and paint can share any colour.
        log_error: Weight in the loss of the logarithm of each component's error as it is scored, albedo after one factor.
            Of a diffusion model's images those alone that are all noise: samples that aim at a score lose their spread.
        noise_alone: Share of a diffusion model's images that it sees as the first step of a sample does: all noise. That step
            alone has to tell light from paint, and is one of a thousand.
        precision: "bf16", "float32", or "auto", which is bf16 where the processor has it.
        compile: Whether the network is compiled for training; "auto": where there is a C++ compiler.
        threads: Threads of the CPU; None for torch's own choice.
        seed: Seed of every draw.
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
    mixture: Mixture = field(default_factory=Mixture)
    scenes: tuple[str, ...] = ()
    steps: Number = 20_000
    minutes: NotNegative | None = None
    batch: Number = 32
    rate: NotNegative = 5e-4
    muon_rate: NotNegative = 0.02
    warmup: Count = 200
    weight_decay: NotNegative = 0.01
    clip_gradient: NotNegative = 1.0
    ema: UnitInterval = 0.999
    background: UnitInterval = 0.1
    level: UnitInterval = 0.25
    log_error: NotNegative = 0.0
    noise_alone: UnitInterval = 0.0
    precision: Literal["auto", "bf16", "float32"] = "auto"
    compile: bool | Literal["auto"] = "auto"
    threads: Number | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0  # validation multiplies it and stays within 64 bits
    checkpoint_minutes: NotNegative = 5.0
    validate_steps: Number = 1000
    validation_images: Number = 64
    validation_sampler_steps: Number = 10
    network: NetworkConfig = field(default_factory=NetworkConfig)
    augmentation: Augmentation = field(default_factory=Augmentation)

    def __post_init__(self) -> None:
        steps, most = self.validation_sampler_steps, self.network.timesteps
        if self.network.kind == "diffusion" and steps > most:
            raise InputError(f"validation_sampler_steps: expected {most} or less, the timesteps of the network, found {steps}")
        if self.noise_alone and self.network.kind != "diffusion":
            raise InputError(f"noise_alone: expected 0 but for a diffusion model, found {self.noise_alone}")

    def identity(self) -> str:
        """Hash of what the weights depend on; a run resumes only where it is the same. It may go on with more ``steps``."""
        free = ("out", "steps", "minutes", "threads", "compile", "checkpoint_minutes", "scenes")
        every = dataclasses.asdict(self).items()
        return identity({key: value for key, value in every if key not in free and not key.startswith("validat")})
