"""The prior's samples as per-pixel targets, and their alignment with the current prediction."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.fit.losses import Alignment, align_views, linear_to_srgb, tone_map
from ia_bench.fit.problem import Problem
from ia_bench.material.textures import fetch
from ia_bench.priors.contract import Prior

ALIGNMENT_PIXELS = 65_536  # at most this many pixels estimate the per-view alignment
ALIGNMENT_PERIOD = 10  # steps between two estimates


class Supervision:
    """Targets (P, 3) per component, aligned per view where the loss asks for it.

    Alignment is an inner minimisation that alternates with the optimiser's steps, so it carries no gradient.
    """

    def __init__(self, problem: Problem, prior: Prior, ssi: str, targets: dict[str, Tensor]) -> None:
        self.targets = targets
        self._problem, self._ssi = problem, ssi
        self._encoding = prior.encoding
        gbuffer = problem.gbuffer
        self._view = gbuffer.pixel // (gbuffer.shape[1] * gbuffer.shape[2])
        self._coverage = (gbuffer.face >= 0).float().mean(1, keepdim=True)
        stride = max(1, len(gbuffer.pixel) // ALIGNMENT_PIXELS)
        covered = torch.nonzero(self._coverage[:, 0] == 1)[:, 0]  # a pixel on the edge mixes in a background
        self._subset = (covered if len(covered) else torch.arange(len(gbuffer.pixel), device=covered.device))[::stride]
        points = gbuffer.face[self._subset]
        self._hit = (points >= 0)[..., None]
        self._uv = problem.renderer.surface.uv(points.clamp_min(0).long(), gbuffer.barycentric[self._subset])
        self._alignment: Alignment | None = None

    def update(self, albedo: Tensor, step: int) -> None:
        """Estimate the alignment again if it is due at ``step``; a pure function of the step and the texture."""
        if "albedo" in self.targets and (self._alignment is None or step % ALIGNMENT_PERIOD == 0):
            with torch.no_grad():
                prediction = (fetch(albedo, self._uv) * self._hit).sum(1) / self._hit.shape[1]
            self._alignment = align_views(
                prediction,
                self.targets["albedo"][self._subset],
                self._view[self._subset],
                self._problem.gbuffer.shape[0],
                self._ssi,
            )

    def alignment_state(self) -> dict[str, Tensor]:
        """What a checkpoint must keep of the alignment between two updates."""
        return {} if self._alignment is None else {"scale": self._alignment.scale, "shift": self._alignment.shift}

    def restore_alignment(self, state: dict[str, Tensor]) -> None:
        """The inverse of :meth:`alignment_state`."""
        self._alignment = Alignment(**state) if state else None

    def albedo_loss(self, prediction: Tensor, pixels: Tensor) -> Tensor:
        """|SSI(k_hat, k_s) - k_s| of (B, 3) predictions at G-buffer entries (B,), in the prior's encoding."""
        assert self._alignment is not None, "update() comes first"
        aligned = self._alignment(prediction, self._view[pixels], self._coverage[pixels])
        return (self._encode("albedo", aligned) - self._encode("albedo", self.targets["albedo"][pixels])).abs().mean()

    def specular_loss(self, prediction: Tensor, pixels: Tensor) -> Tensor:
        """|S_hat - S_s| of tone-mapped radiance: highlights span orders of magnitude, their log does not."""
        return (tone_map(prediction) - tone_map(self.targets["specular"][pixels])).abs().mean()

    def _encode(self, component: str, values: Tensor) -> Tensor:
        return linear_to_srgb(values) if self._encoding[component] == "srgb" else values


def draw_targets(problem: Problem, prior: Prior, *, seed: int, guidance: dict[str, Tensor] | None) -> dict[str, Tensor]:
    """One prior sample per training view, as (P, 3) per component. ``guidance``: current renders, (P, 3) per component.

    Raises ValueError when the prior breaks its contract (wrong components, shapes, NaN): its user needs to know which.
    """
    views = problem.scene.train
    images = torch.stack([torch.from_numpy(view.image) for view in views])
    masks = torch.stack([torch.from_numpy(view.mask) for view in views])
    guide = None if guidance is None else {name: problem.images_of(value).cpu() for name, value in guidance.items()}
    samples = prior.sample(images, masks, seed=seed, guidance=guide)
    if set(samples) != set(prior.provides):
        raise ValueError(f"the prior provides {sorted(prior.provides)} but sampled {sorted(samples)}")
    for name, sample in samples.items():
        if sample.shape != images.shape:
            raise ValueError(f"the prior's {name} has shape {tuple(sample.shape)}, expected {tuple(images.shape)}")
        if not bool(torch.isfinite(sample).all()):
            raise ValueError(f"the prior's {name} has NaN or Inf in {int((~torch.isfinite(sample)).sum())} values")
    device = problem.gbuffer.face.device
    return {name: problem.pixels_of(sample.to(device)) for name, sample in samples.items()}
