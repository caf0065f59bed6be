"""The training loop of the priors: ``accelerate`` for devices and processes, every draw a function of (seed, step).

Because nothing depends on a running generator, a run that resumes from any checkpoint meets the same batches and the same
noise as one that was never stopped.
"""

from __future__ import annotations

import dataclasses
import io
import math
import platform
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.network import FEATURES, MaterialNetwork, load_network
from ia_bench_training.dataset import Batch, TrainingImages, drawn_by
from ia_bench_training.losses import log_error, weighted_error
from ia_bench_training.optimiser import MuonAdamW, split_weights
from ia_bench_training.resuming import (
    batch_index,
    check_gradient,
    check_seeds,
    rate_factor,
    run,
    stream,
    write_validation,
)
from ia_bench_training.saving import save_network
from ia_bench_training.settings import TrainSettings
from ia_bench_training.speed import compiles, trains_in_bf16
from ia_bench_training.validation import score_single_view
from ia_bench_training.world.images import Mixture, WorldImages
from ia_bench_training.world.layout import WORLD

PICTURES = 8  # images of a sample grid


def train(settings: TrainSettings, progress: Progress) -> dict[str, Any]:
    """Train (or go on training) and return the last validation figures; the weights are in ``settings.out``/weights.

    Of several processes the first alone says anything and returns any.
    """
    import_torchvision()  # before diffusers and accelerate, which import it
    from accelerate import Accelerator

    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    accelerator = Accelerator(mixed_precision="bf16" if trains_in_bf16(settings.precision, device) else "no")
    if settings.batch % accelerator.num_processes:
        raise InputError(f"batch: expected a multiple of the {accelerator.num_processes} processes, found {settings.batch}")
    main = accelerator.is_main_process
    progress = progress if main else Progress(io.StringIO())
    trainee = _Training(settings, accelerator, progress)
    run(
        trainee,
        settings.out,
        steps=settings.steps,
        identity=settings.identity(),
        progress=progress,
        validate_steps=settings.validate_steps,
        checkpoint_minutes=settings.checkpoint_minutes,
        minutes=settings.minutes,
        writes=main,
        agree=trainee.agree,
    )
    trainee.ahead.shutdown(cancel_futures=True)
    accelerator.wait_for_everyone()
    return trainee.figures if main else {}


def start_as_regressor(network: MaterialNetwork, regressor: MaterialNetwork) -> None:
    """Give a diffusion ``network`` the weights of a ``regressor`` of its shape, and of zero where it reads noise and its level.

    Whatever noisy components it is given, it then answers as the regressor does, the mean of what is possible: an
    estimate of the clean components from which training learns what noise adds.
    """
    state, noise = regressor.state_dict(), network.config.output_channels
    told = regressor.unet.time_proj(torch.tensor([regressor.config.timesteps - 1]))  # the one level of which it has ever heard
    weight = state["unet.time_embedding.linear_1.weight"]
    state["unet.time_embedding.linear_1.bias"] = state["unet.time_embedding.linear_1.bias"] + weight @ told[0].to(weight)
    state["unet.time_embedding.linear_1.weight"] = torch.zeros_like(weight)
    folded = state["unet.conv_in.weight"]
    state["unet.conv_in.weight"] = torch.cat([folded.new_zeros(len(folded), noise * network.config.fold**2, 3, 3), folded], 1)
    full = state["head.enter.weight"]
    state["head.enter.weight"] = torch.cat([full[:, :FEATURES], full.new_zeros(len(full), noise, 3, 3), full[:, FEATURES:]], 1)
    network.load_state_dict(state)


class _Training:
    """The state of one training run in one process."""

    def __init__(self, settings: TrainSettings, accelerator: Any, progress: Progress) -> None:  # noqa: ANN401 (lazy import)
        from diffusers.training_utils import EMAModel

        self.settings, self.accelerator, self.progress = settings, accelerator, progress
        self.images: TrainingImages | WorldImages
        if (settings.data / WORLD).is_file():
            self.images = WorldImages(settings.data, settings.mixture, accelerator.device)
        elif settings.mixture != Mixture():
            raise InputError(f"mixture: expected none but for a world, found {settings.mixture} for {settings.data}, which is none")
        else:
            self.images = TrainingImages(settings.data, device=accelerator.device)
        self.held_out = TrainingImages(settings.validation, limit=settings.validation_images)
        self.scenes: list[Any] = []
        if settings.scenes:  # imports that a machine which only trains need not have
            from ia_bench_training.single_view_scores import load_examples

            self.scenes = [load_examples(name) for name in settings.scenes]
        for images in (self.images, self.held_out):
            if images.size != settings.network.size:
                raise InputError(f"{images.folder}: expected images of network.size={settings.network.size}, found {images.size}")
        check_seeds("images", self.images, self.held_out)
        torch.manual_seed(settings.seed)
        self.network = MaterialNetwork(settings.network)
        self._init: dict[str, Any] | None = None
        if settings.init is not None:
            start, self._init = load_network(settings.init)
            if dataclasses.replace(start.config, kind=settings.network.kind) != settings.network:
                raise InputError(f"init: {settings.init}: expected a network of {settings.network}, found {start.config}")
            if start.config.kind == settings.network.kind:
                self.network.load_state_dict(start.state_dict())
            elif settings.network.kind == "diffusion":
                start_as_regressor(self.network, start)
            else:
                raise InputError(f"init: {settings.init}: expected a regressor, found a diffusion network, whose inputs are more")
        self.schedule = None
        if settings.network.kind == "diffusion":
            self.schedule = settings.network.noise_schedule.alpha_bar.float().to(accelerator.device)
        hidden, others = split_weights(self.network, muon=settings.muon_rate > 0)
        adamw = torch.optim.AdamW(others, lr=settings.rate, weight_decay=settings.weight_decay, fused=True)
        self.ema = EMAModel(self.network.parameters(), decay=settings.ema, use_ema_warmup=True, power=0.75)
        self.figures: dict[str, Any] = {}
        self.model, adamw = accelerator.prepare(self.network, adamw)
        self.optimizer = MuonAdamW(adamw, hidden, muon_rate=settings.muon_rate, weight_decay=settings.weight_decay)
        self.ema.to(accelerator.device)
        compiled = compiles(settings.compile, "the network", progress.note)
        self.predict = torch.compile(self.model) if compiled else self.model
        self.ahead = ThreadPoolExecutor(1)
        self._coming: Future[tuple[Batch, dict[str, Tensor]]] | None = None
        self._writer: Any = None  # of the main process

    def step(self, number: int) -> float:
        """See :class:`ia_bench_training.resuming.Trainee`."""
        settings = self.settings
        if self.accelerator.is_main_process and self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(settings.out / "tensorboard", purge_step=number)
        batch, draws = self._coming.result() if self._coming is not None else self._draw(number)
        self._coming = self.ahead.submit(self._draw, number + 1)  # while the network works on this one
        with self.accelerator.autocast():
            output = self._predicted(batch, draws)
        output = output.float()
        loss = weighted_error(output - batch.target, batch.masks, level=settings.level, background=settings.background)
        blind = draws["timestep"] == settings.network.timesteps - 1
        if settings.log_error and bool(blind.any()):
            found, true, masks = output[blind].split(3, 1), batch.target[blind].split(3, 1), batch.masks[blind]
            parts = zip(settings.network.components, found, true, strict=True)
            errors = [log_error(one, other, masks, aligned=component == "albedo") for component, one, other in parts]
            loss = loss + settings.log_error * torch.stack(errors).sum()
        self.accelerator.backward(loss)
        norm = self.accelerator.clip_grad_norm_(self.model.parameters(), settings.clip_gradient or math.inf)
        check_gradient(norm, self.network)
        self.optimizer.step(rate_factor(number, settings.steps, settings.warmup))
        self.ema.step(self.network.parameters())
        if self._writer is not None and (number + 1) % 20 == 0:
            self._writer.add_scalar("loss", loss.detach(), number + 1)
            self._writer.add_scalar("rate", rate_factor(number + 1, settings.steps, settings.warmup), number + 1)
        return float(loss.detach())

    def _draw(self, step: int) -> tuple[Batch, dict[str, Tensor]]:
        """This process's share of the batch of ``step``, and its random numbers."""
        settings = self.settings
        index = batch_index(len(self.images), settings.batch, settings.seed, step)
        share = index[self.accelerator.process_index :: self.accelerator.num_processes]
        # Of the device, beside whose images draws are made; another kind of device draws others.
        seed = stream(settings.seed, step, self.accelerator.process_index)
        generator = torch.Generator(self.accelerator.device).manual_seed(seed)
        batch, at = self.images.batch(share, settings.network, settings.augmentation, generator), drawn_by(generator)
        if self.schedule is None:  # a regressor always sees its image
            return batch, {"timestep": torch.full((len(share),), settings.network.timesteps - 1, device=self.accelerator.device)}
        last = len(self.schedule) - 1
        draws = {"noise": torch.randn(batch.target.shape, **at), "timestep": torch.randint(last + 1, (len(share),), **at)}
        draws["timestep"][torch.rand(len(share), **at) < settings.noise_alone] = last
        return batch, draws

    def _predicted(self, batch: Batch, draws: dict[str, Tensor]) -> Tensor:
        """The network's estimate (N, 3 C, H, W) of the batch's target."""
        if self.schedule is None:
            return self.predict(None, draws["timestep"], batch.condition)
        level = self.schedule[draws["timestep"]][:, None, None, None]
        noisy = level.sqrt() * batch.target + (1 - level).sqrt() * draws["noise"]
        return self.predict(noisy, draws["timestep"], batch.condition)

    def agree(self, mine: bool) -> bool:
        """The main process decides for all, since clocks differ."""
        from accelerate.utils import broadcast

        if self.accelerator.num_processes == 1:
            return mine
        return bool(broadcast(torch.tensor(float(mine), device=self.accelerator.device)) > 0)

    def validate(self, done: int, seconds: float) -> None:
        """See :class:`ia_bench_training.resuming.Trainee`; the main process alone does."""
        if self._writer is None:
            return
        settings = self.settings
        self.ema.store(self.network.parameters())
        self.ema.copy_to(self.network.parameters())
        self.network.eval()
        index = torch.arange(min(settings.validation_images, len(self.held_out)))
        scored = score_single_view(self.network, self.held_out, index, steps=settings.validation_sampler_steps, seed=settings.seed)
        self.figures = {name: round(value, 3) for name, value in (scored.figures | self._on_scenes()).items()}
        self.network.train()
        self.ema.restore(self.network.parameters())
        for name, value in self.figures.items():
            self._writer.add_scalar(f"validation/{name}", value, done)
        rows = [image[:PICTURES].flatten(0, 1).clamp(0, 1) ** (1 / 2.2) for image in scored.pictures.values()]
        self._writer.add_image("validation", torch.cat(rows, 1), done, dataformats="HWC")
        self.progress.note(f"step {done}: " + ", ".join(f"{name} {value:.2f}" for name, value in self.figures.items()))
        write_validation(settings.out, done, seconds, self.figures)

    def _on_scenes(self) -> dict[str, float]:
        """The score of albedo in development scenes, at the size of their views, beside that of one grey."""
        found = {}
        if self.scenes:
            from ia_bench.runs.decomposition import make_prior
            from ia_bench_training.single_view_scores import COLUMNS, score

            folder, kind = self.settings.out / "judged", self.settings.network.kind
            save_network(folder, self.network, {})
            prior = make_prior(kind, {"weights": folder})
            for examples in self.scenes:
                scored = score(prior, examples, samples=1, seed=self.settings.seed)
                for name in ("grey", "one"):
                    found[f"{Path(examples.name).name}_{name}"] = scored[COLUMNS[f"albedo_{name}"]]
        return found

    def save(self, done: int, seconds: float) -> None:
        """See :class:`ia_bench_training.resuming.Trainee`."""
        self.ema.store(self.network.parameters())
        self.ema.copy_to(self.network.parameters())
        save_network(self.settings.out / "weights", self.network, self._provenance(done, seconds))
        self.ema.restore(self.network.parameters())

    def state_dict(self) -> dict[str, Any]:
        """Return the weights, their average, the optimiser's moments, and what goes with them."""
        return {
            "figures": self.figures,
            "init": self._init,
            "circumstances": self._circumstances(),
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "ema": self.ema.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state, and say in what the run is no longer the one that was stopped."""
        self.network.load_state_dict(state["network"])
        self.ema.load_state_dict(state["ema"])
        self.ema.to(self.accelerator.device)
        self.optimizer.load_state_dict(state["optimizer"])
        self.figures, self._init = state["figures"], state["init"]  # of the weights that it began with, whatever lies there now
        for name, now in self._circumstances().items():
            if state["circumstances"][name] != now:
                self.progress.note(
                    f"{self.settings.out}: {now} {name}, and {state['circumstances'][name]} when the run was stopped; "
                    "the weights will not be those of a run without the stop"
                )

    def _circumstances(self) -> dict[str, Any]:
        """Return what a run's numbers depend on although its settings do not say it."""
        accelerator = self.accelerator
        return {
            "images": len(self.images),
            "seeds": sorted(self.images.seeds),
            "steps": self.settings.steps,  # along which rates fall
            "processes": accelerator.num_processes,
            "precision": "bf16" if accelerator.mixed_precision == "bf16" else "float32",
            "device": accelerator.device.type,  # which draws
        }

    def _provenance(self, done: int, seconds: float) -> dict[str, Any]:
        settings = self.settings
        return {
            "steps": done,
            "batch": settings.batch,
            "seconds": round(seconds),
            "images": len(self.images),
            "processes": self.accelerator.num_processes,
            "threads": torch.get_num_threads(),
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else platform.machine(),
            "seed": settings.seed,
            "init": self._init,
            "validation": self.figures,
        }
