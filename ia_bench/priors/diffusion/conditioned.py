"""A network bound to the images that it explains: what the sampler calls."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.priors.diffusion.network import MaterialNetwork
from ia_bench.priors.diffusion.sampler import Denoise
from ia_bench.priors.diffusion.schedule import NoiseSchedule, estimate_x0


class Conditioned:
    """``network`` asked about a batch of conditions; counts its evaluations (one per image and pass) in ``calls``.

    ``cfg_scale`` w: classifier-free guidance, output = uncond + w (cond - uncond) (Ho and Salimans 2022); 1 asks once
    per step, any other value twice. ``chunk``: images per pass, which bounds memory.
    """

    def __init__(
        self, network: MaterialNetwork, schedule: NoiseSchedule, *, cfg_scale: float = 1.0, chunk: int = 64, bf16: bool = False
    ) -> None:
        self.network, self.schedule = network, schedule
        self.cfg_scale, self.chunk, self.bf16 = cfg_scale, chunk, bf16
        self.calls = 0

    def bind(self, condition: Tensor) -> Denoise:
        """The denoiser of (N, condition_channels, H, W) images; their tokens are computed here, once.

        It may be called with any whole multiple k of N noisy images: image i is explained by condition i mod N, so that
        several samples of one image share the encoder's work.
        """
        tokens = self._tokens(condition)

        def denoise(noisy: Tensor, t: int) -> Tensor:
            level = float(self.schedule.alpha_bar[t])
            return estimate_x0(self.network.config.prediction_type, self._output(noisy, t, condition, tokens), noisy, level)

        return denoise

    def regress(self, condition: Tensor) -> Tensor:
        """The regressor's estimate (N, 3 C, H, W)."""
        tokens = self._tokens(condition)
        parts = []
        for part in torch.arange(len(condition), device=condition.device).split(self.chunk):
            timestep = torch.full((len(part),), self.network.config.last_timestep, device=condition.device)
            with self._precision():
                parts.append(self.network.denoise(None, timestep, condition[part], _rows(tokens, part)).float())
            self.calls += len(part)
        return torch.cat(parts)

    def _tokens(self, condition: Tensor) -> Tensor | None:
        with torch.no_grad(), self._precision():
            parts = [self.network.tokens(part) for part in condition.split(self.chunk)]
        tokens = [part.float() for part in parts if part is not None]
        return torch.cat(tokens) if tokens else None

    def _output(self, noisy: Tensor, t: int, condition: Tensor, tokens: Tensor | None) -> Tensor:
        parts = []
        for part in torch.arange(len(noisy), device=noisy.device).split(self.chunk):
            timestep = torch.full((len(part),), t, device=noisy.device)
            image = part % len(condition)
            channels, words = condition[image], _rows(tokens, image)
            with self._precision():
                output = self.network.denoise(noisy[part], timestep, channels, words).float()
                self.calls += len(part)
                if self.cfg_scale != 1:
                    nothing = None if words is None else torch.zeros_like(words)
                    plain = self.network.denoise(noisy[part], timestep, torch.zeros_like(channels), nothing).float()
                    self.calls += len(part)
                    output = plain + self.cfg_scale * (output - plain)
            parts.append(output)
        return torch.cat(parts)

    def _precision(self) -> torch.autocast:
        return torch.autocast(next(self.network.parameters()).device.type, torch.bfloat16, enabled=self.bf16)


def _rows(tokens: Tensor | None, index: Tensor) -> Tensor | None:
    return None if tokens is None else tokens[index]
