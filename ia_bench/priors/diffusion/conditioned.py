"""A network bound to the images that it explains: what the sampler calls."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.priors.diffusion.network import MaterialNetwork
from ia_bench.priors.diffusion.schedule import Denoise, NoiseSchedule, estimate_x0


class Conditioned:
    """``network`` asked about a batch of conditions; counts its evaluations (one per image and pass) in ``calls``.

    ``chunk``: images per pass, which bounds memory.
    """

    def __init__(self, network: MaterialNetwork, schedule: NoiseSchedule, *, chunk: int = 64, bf16: bool = False) -> None:
        self.network, self.schedule = network, schedule
        self.chunk, self.bf16 = chunk, bf16
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
            with self._precision():
                parts.append(self.network.denoise(noisy[part], timestep, condition[image], _rows(tokens, image)).float())
            self.calls += len(part)
        return torch.cat(parts)

    def _precision(self) -> torch.autocast:
        return torch.autocast(next(self.network.parameters()).device.type, torch.bfloat16, enabled=self.bf16)


def _rows(tokens: Tensor | None, index: Tensor) -> Tensor | None:
    return None if tokens is None else tokens[index]
