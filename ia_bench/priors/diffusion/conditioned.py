"""A network bound to the images that it explains: what the sampler calls."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.priors.diffusion.network import MaterialNetwork
from ia_bench.priors.diffusion.schedule import Denoise


class Conditioned:
    """``network`` asked about a batch of conditions; counts its evaluations (one per image and pass) in ``calls``.

    ``chunk``: images per pass, which bounds memory.
    """

    def __init__(self, network: MaterialNetwork, *, chunk: int = 64, bf16: bool = False) -> None:
        self.network, self.chunk, self.bf16 = network, chunk, bf16
        self.calls = 0

    def bind(self, condition: Tensor) -> Denoise:
        """The denoiser of (N, condition_channels, H, W) images; their tokens are computed here, once.

        It may be called with any whole multiple k of N noisy images: image i is explained by condition i mod N, so that
        several samples of one image share the encoder's work.
        """
        tokens = self._tokens(condition)

        def denoise(noisy: Tensor, t: int) -> Tensor:
            return self._output(noisy, len(noisy), t, condition, tokens)

        return denoise

    def regress(self, condition: Tensor) -> Tensor:
        """The regressor's estimate (N, 3 C, H, W)."""
        return self._output(None, len(condition), self.network.config.last_timestep, condition, self._tokens(condition))

    def _tokens(self, condition: Tensor) -> Tensor | None:
        with torch.no_grad(), self._precision():
            parts = [self.network.tokens(part) for part in condition.split(self.chunk)]
        tokens = [part.float() for part in parts if part is not None]
        return torch.cat(tokens) if tokens else None

    def _output(self, noisy: Tensor | None, count: int, t: int, condition: Tensor, tokens: Tensor | None) -> Tensor:
        parts = []
        for part in torch.arange(count, device=condition.device).split(self.chunk):
            timestep, image = torch.full((len(part),), t, device=condition.device), part % len(condition)
            seen = None if noisy is None else noisy[part]
            with self._precision():
                known = None if tokens is None else tokens[image]
                parts.append(self.network.denoise(seen, timestep, condition[image], known).float())
            self.calls += len(part)
        return torch.cat(parts)

    def _precision(self) -> torch.autocast:
        return torch.autocast(next(self.network.parameters()).device.type, torch.bfloat16, enabled=self.bf16)
