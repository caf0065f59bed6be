"""The training loop of the priors: ``accelerate`` for devices and processes, every draw a function of (seed, step).

Because nothing depends on a running generator, a run that resumes from any checkpoint meets the same batches and the same
noise as one that was never stopped.
"""

from __future__ import annotations

import io
import math
import platform
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.common.torchvision_shim import import_torchvision
from ia_bench.priors.diffusion.checkpoints import load_network, read_description, save_network
from ia_bench.priors.diffusion.network import MaterialNetwork
from ia_bench.priors.inputs import use_bf16
from ia_bench_training.dataset import Batch, TrainingImages, drawn_by
from ia_bench_training.optimiser import MuonAdamW, split_weights
from ia_bench_training.resuming import (
    batch_index,
    check_gradient,
    check_seeds,
    forget_validations_after,
    load_state,
    rate_factor,
    save_state,
    stream,
    write_validation,
)
from ia_bench_training.settings import TrainSettings
from ia_bench_training.validation import score_single_view

PICTURES = 8  # images of a sample grid
STATE_FORMAT = 3  # raised when a change of the code changes what state.pt holds


def train(settings: TrainSettings, progress: Progress) -> dict[str, Any]:
    """Train (or go on training) and return the last validation figures; the weights are in ``settings.out``/weights.

    Of several processes the first alone says anything and returns any.
    """
    import_torchvision()  # before diffusers and accelerate, which import it
    from accelerate import Accelerator

    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    accelerator = Accelerator(mixed_precision="bf16" if use_bf16(settings.precision, device) else "no")
    if settings.batch % accelerator.num_processes:
        raise InputError(f"batch: expected a multiple of the {accelerator.num_processes} processes, found {settings.batch}")
    if accelerator.is_main_process:
        return _Training(settings, accelerator, progress).finish()
    _Training(settings, accelerator, Progress(io.StringIO())).finish()
    return {}


class _Training:
    """The state of one training run in one process."""

    def __init__(self, settings: TrainSettings, accelerator: Any, progress: Progress) -> None:  # noqa: ANN401 (lazy import)
        from diffusers.training_utils import EMAModel

        self.settings, self.accelerator, self.progress = settings, accelerator, progress
        self.images = TrainingImages(settings.data, device=accelerator.device)
        self.held_out = TrainingImages(settings.validation, limit=settings.validation_images)
        for images in (self.images, self.held_out):
            if images.size != settings.network.size:
                raise InputError(f"{images.folder}: expected images of network.size={settings.network.size}, found {images.size}")
        check_seeds("images", self.images, self.held_out)
        torch.manual_seed(settings.seed)
        self.network = MaterialNetwork(settings.network)
        if settings.init is not None:
            start, _ = load_network(settings.init)
            if start.config != settings.network:
                raise InputError(f"init: {settings.init}: expected a network of {settings.network}, found {start.config}")
            self.network.load_state_dict(start.state_dict())
        self.schedule = None
        if settings.network.kind == "diffusion":
            self.schedule = settings.network.noise_schedule.alpha_bar.float().to(accelerator.device)
        hidden, others = split_weights(self.network, muon=settings.muon_rate > 0)
        adamw = torch.optim.AdamW(others, lr=settings.rate, weight_decay=settings.weight_decay, fused=True)
        self.ema = EMAModel(self.network.parameters(), decay=settings.ema, use_ema_warmup=True, power=0.75)
        self.step, self.seconds = 0, 0.0
        self.figures: dict[str, Any] = {}
        state = load_state(settings.out, STATE_FORMAT, settings.identity())
        if state is not None:
            self.network.load_state_dict(state["network"])
            self.ema.load_state_dict(state["ema"])
            self.step, self.seconds, self.figures = state["step"], state["seconds"], state["figures"]
            for name, now in self._circumstances().items():
                if state["circumstances"][name] != now:
                    progress.note(
                        f"{settings.out}: {now} {name}, and {state['circumstances'][name]} when the run was stopped; "
                        "the weights will not be those of a run without the stop"
                    )
        self.model, adamw = accelerator.prepare(self.network, adamw)
        self.optimizer = MuonAdamW(adamw, hidden, muon_rate=settings.muon_rate, weight_decay=settings.weight_decay)
        if state is not None:
            self.optimizer.load_state_dict(state["optimizer"])
        self.ema.to(accelerator.device)
        self.predict = torch.compile(self.model) if settings.compile else self.model
        self._ahead = ThreadPoolExecutor(1)
        self._coming: Future[tuple[Batch, dict[str, Tensor]]] | None = None

    def finish(self) -> dict[str, Any]:
        from torch.utils.tensorboard import SummaryWriter

        settings, main = self.settings, self.accelerator.is_main_process
        self.writer = SummaryWriter(settings.out / "tensorboard", purge_step=self.step) if main else None
        if main:
            forget_validations_after(self.step, settings.out)
        task = self.progress.task("training", settings.steps, self.step)
        started = saved = time.monotonic()
        while self.step < settings.steps:
            before = time.monotonic()
            loss = self._optimise()
            self.step += 1
            self.seconds += time.monotonic() - before
            task.advance(1, loss=loss)
            if self.writer is not None and self.step % 20 == 0:
                self.writer.add_scalar("loss", loss, self.step)
                self.writer.add_scalar("rate", rate_factor(self.step, settings.steps, settings.warmup), self.step)
            now = time.monotonic()
            out_of_time = settings.minutes is not None and now - started > 60 * settings.minutes
            last = self.step == settings.steps or self._agree(out_of_time)
            if self.step % settings.validate_steps == 0 or last:
                self._validate()
            if self._agree(now - saved > 60 * settings.checkpoint_minutes) or last:
                self._save()
                saved = now
            if last:
                break
        self._ahead.shutdown(cancel_futures=True)
        self.accelerator.wait_for_everyone()
        return self.figures

    def _optimise(self) -> float:
        settings = self.settings
        batch, draws = self._coming.result() if self._coming is not None else self._draw(self.step)
        self._coming = self._ahead.submit(self._draw, self.step + 1)  # while the network works on this one
        with self.accelerator.autocast():
            output = self._predicted(batch, draws)
        loss = weighted_error(output.float() - batch.target, batch.masks, level=settings.level, background=settings.background)
        self.accelerator.backward(loss)
        norm = self.accelerator.clip_grad_norm_(self.model.parameters(), settings.clip_gradient or math.inf)
        check_gradient(norm, self.step)
        self.optimizer.step(rate_factor(self.step, settings.steps, settings.warmup))
        self.ema.step(self.network.parameters())
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
        draws = {
            "noise": torch.randn(batch.target.shape, **at),
            "timestep": torch.randint(1000 if self.schedule is None else len(self.schedule), (len(share),), **at),
        }
        return batch, draws

    def _predicted(self, batch: Batch, draws: dict[str, Tensor]) -> Tensor:
        """The network's estimate (N, 3 C, H, W) of the batch's target."""
        if self.schedule is None:  # the regressor always sees its image
            timestep = torch.full_like(draws["timestep"], self.settings.network.last_timestep)
            return self.predict(None, timestep, batch.condition)
        level = self.schedule[draws["timestep"]][:, None, None, None]
        noisy = level.sqrt() * batch.target + (1 - level).sqrt() * draws["noise"]
        return self.predict(noisy, draws["timestep"], batch.condition)

    def _agree(self, mine: bool) -> bool:
        """The main process decides for all, since clocks differ."""
        from accelerate.utils import broadcast

        if self.accelerator.num_processes == 1:
            return mine
        return bool(broadcast(torch.tensor(float(mine), device=self.accelerator.device)) > 0)

    def _validate(self) -> None:
        if self.writer is None:
            return
        settings = self.settings
        self.ema.store(self.network.parameters())
        self.ema.copy_to(self.network.parameters())
        self.network.eval()
        index = torch.arange(min(settings.validation_images, len(self.held_out)))
        scored = score_single_view(self.network, self.held_out, index, steps=settings.validation_sampler_steps, seed=settings.seed)
        self.network.train()
        self.ema.restore(self.network.parameters())
        self.figures = {name: round(value, 3) for name, value in scored.figures.items()}
        for name, value in scored.figures.items():
            self.writer.add_scalar(f"validation/{name}", value, self.step)
        rows = [image[:PICTURES].flatten(0, 1).clamp(0, 1) ** (1 / 2.2) for image in scored.pictures.values()]
        self.writer.add_image("validation", torch.cat(rows, 1), self.step, dataformats="HWC")
        self.progress.note(f"step {self.step}: " + ", ".join(f"{name} {value:.2f}" for name, value in self.figures.items()))
        write_validation(settings.out, self.step, self.seconds, self.figures)

    def _save(self) -> None:
        if not self.accelerator.is_main_process:
            return
        settings = self.settings
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "figures": self.figures,
            "circumstances": self._circumstances(),
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "ema": self.ema.state_dict(),
        }
        save_state(settings.out, STATE_FORMAT, settings.identity(), state)
        self.ema.store(self.network.parameters())
        self.ema.copy_to(self.network.parameters())
        save_network(settings.out / "weights", self.network, self._provenance())
        self.ema.restore(self.network.parameters())

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

    def _provenance(self) -> dict[str, Any]:
        settings = self.settings
        return {
            "steps": self.step,
            "batch": settings.batch,
            "seconds": round(self.seconds),
            "images": len(self.images),
            "processes": self.accelerator.num_processes,
            "threads": torch.get_num_threads(),
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else platform.machine(),
            "seed": settings.seed,
            "init": None if settings.init is None else read_description(settings.init)["provenance"],
            "validation": self.figures,
        }


def weighted_error(difference: Tensor, masks: Tensor, *, level: float, background: float) -> Tensor:
    """The mean square of ``difference`` (N, C, H, W), in which an error of the colour and one of the structure weigh differently.

    Inside ``masks`` (N, H, W) each channel's mean over an image counts ``level``, the rest counts 1; pixels outside count
    ``background``. No such weights move the minimum of a square, which is the expectation of the truth.
    """
    inside = (masks[:, None] > 0).float()
    pixels = inside.sum((2, 3), keepdim=True)
    mean = (difference * inside).sum((2, 3), keepdim=True) / pixels.clamp_min(1)
    inner = ((difference - mean).square() * inside).sum() + level * (mean.square() * pixels).sum()
    outer = (difference.square() * (1 - inside)).sum()
    count = (pixels + background * (masks[0].numel() - pixels)).sum() * difference.shape[1]
    return (inner + background * outer) / count
