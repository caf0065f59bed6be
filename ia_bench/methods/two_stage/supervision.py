"""The prior's part of equation 5: its predictions as targets, as a similarity kernel, or distilled."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.material.textures import fetch
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.kernel import SimilarityKernel
from ia_bench.methods.two_stage.losses import ViewAlignment, align_views, encode, tone_map
from ia_bench.methods.two_stage.targets import Targets
from ia_bench.priors.contract import Prior

ALIGNMENT_PIXELS = 65_536  # about this many pixels of all views, and their share of those asked about, estimate the alignment
ALIGNMENT_PERIOD = 10  # steps between two estimates


class Supervision:
    """The losses of one set of targets, of the kind that ``problem.supervision`` names.

    ViewAlignment of a target is an inner minimisation that alternates with the optimiser's steps, so it carries no gradient.
    A distilled target needs none: it was made from the render itself.
    """

    def __init__(self, problem: Problem, prior: Prior, ssi: str, targets: Targets) -> None:
        self.targets = targets
        self._problem, self._settings = problem, problem.supervision
        self._encoding = prior.info.encoding
        self._distilled = self._settings.kind == "sds"
        self._alignment: ViewAlignment | None = None
        self._aligner = _Aligner(problem, targets, ssi) if self.sets_albedo else None
        self._kernel: SimilarityKernel | None = None
        if "albedo" in targets.values and self._settings.kind == "similarity":
            self._kernel = SimilarityKernel(problem, targets, self._settings, free_scale=ssi != "none")

    @property
    def sets_albedo(self) -> bool:
        """Whether the targets say which albedo a pixel has, not only which pixels share one."""
        return "albedo" in self.targets.values and self._settings.kind == "target"

    def update(self, albedo: Tensor, step: int) -> None:
        """Estimate the alignment again if targets need it and it is due at ``step``; a pure function of step and texture."""
        if self._aligner is not None and (self._alignment is None or step % ALIGNMENT_PERIOD == 0):
            self._alignment = self._aligner.align(albedo)

    def alignment(self) -> dict[str, Tensor]:
        """What a checkpoint must keep besides the targets: the alignment between two updates, nothing before the first."""
        return {} if self._alignment is None else dict(vars(self._alignment))

    def form_of_alignment(self) -> dict[str, Tensor]:
        """What :meth:`alignment` looks like where there is one."""
        each = torch.zeros(self._problem.gbuffer.shape[0])
        return {"scale": each, "shift": each}

    def restore_alignment(self, state: dict[str, Tensor]) -> None:
        """Take over an :meth:`alignment`."""
        device = self._problem.device  # checkpoints are read on the CPU
        self._alignment = ViewAlignment(**{name: value.to(device) for name, value in state.items()}) if state else None

    def albedo_loss(self, prediction: Tensor, pixels: Tensor, texture: Tensor, generator: torch.Generator) -> Tensor:
        """Loss of the albedo at G-buffer entries (B,): of (B, 3) predictions, or as a kernel of the ``texture`` that shows them."""
        if self._kernel is not None:
            return self._settings.kernel_weight * self._kernel.loss(pixels, texture, generator)
        return self._settings.target_weight * self._target_loss(prediction, pixels)

    def _target_loss(self, prediction: Tensor, pixels: Tensor) -> Tensor:
        """|SSI(k_hat, k_s) - k_s| in the prior's encoding; distilled: the square, whose gradient is that of SDS."""
        if self._distilled:
            return self._difference("albedo", prediction, pixels)
        assert self._alignment is not None, "update() comes first"
        gbuffer = self._problem.gbuffer
        coverage = (gbuffer.face[pixels] >= 0).float().mean(1, keepdim=True)
        aligned = self._alignment(prediction, gbuffer.view(pixels), coverage)
        return self._difference("albedo", aligned, pixels)

    def specular_loss(self, prediction: Tensor, pixels: Tensor) -> Tensor:
        """|S_hat - S_s| of tone-mapped radiance: highlights span orders of magnitude, their log does not.

        Where the prior could hardly have said more, only what falls short of it counts.
        Distilled: the square in the prior's encoding, in which it was noised and denoised.
        """
        if not self._settings.specular_weight:
            return torch.zeros((), device=prediction.device)
        if self._distilled:
            return self._settings.specular_weight * self._difference("specular", prediction, pixels)
        unit = self._problem.photographs.unit
        difference = tone_map(unit * prediction) - tone_map(unit * self.targets.values["specular"][pixels])
        if "specular" in self.targets.at_least:
            difference = torch.where(self.targets.at_least["specular"][pixels], difference.clamp(max=0), difference)
        return self._settings.specular_weight * (self.targets.weight[pixels] * difference.abs()).mean()

    def _difference(self, name: str, prediction: Tensor, pixels: Tensor) -> Tensor:
        encoding = self._encoding[name]
        difference = encode(prediction, encoding) - encode(self.targets.values[name][pixels], encoding)
        error = 0.5 * difference**2 if self._distilled else difference.abs()
        return (self.targets.weight[pixels] * error).mean()


class _Aligner:
    """Estimates how the texture's albedo is aligned with its targets, from some of the pixels that the prior was asked about."""

    def __init__(self, problem: Problem, targets: Targets, ssi: str) -> None:
        """``ssi``: the mode of :func:`align_views`."""
        gbuffer = problem.gbuffer
        asked = targets.weight[:, 0] > 0
        covered = torch.nonzero(asked & gbuffer.filled)[:, 0]
        usable = covered if len(covered) else torch.nonzero(asked)[:, 0]
        chosen = usable[:: max(1, len(gbuffer.pixel) // ALIGNMENT_PIXELS)]
        face = gbuffer.face[chosen]
        self._hit = (face >= 0)[..., None]
        self._uv = problem.renderer.surface.uv(face.clamp_min(0).long(), gbuffer.barycentric[chosen])
        self._target, self._view = targets.values["albedo"][chosen], gbuffer.view(chosen)
        self._views, self._ssi = gbuffer.shape[0], ssi

    @torch.no_grad()
    def align(self, albedo: Tensor) -> ViewAlignment:
        """The alignment of the texture ``albedo`` (T, T, 3)."""
        prediction = (fetch(albedo, self._uv) * self._hit).sum(1) / self._hit.shape[1]
        return align_views(prediction, self._target, self._view, self._views, self._ssi)
