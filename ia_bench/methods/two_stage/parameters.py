"""What a fit optimises, and the step that Adam makes of its gradients."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.optim import Optimizer

from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material, fill_unobserved, splat
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.methods.two_stage.steps import MultigridSteps, ScaleAmbiguityStep
from ia_bench.render.gbuffer import PIXELS_AT_ONCE

LEAST = {"albedo": 0.0, "roughness": MIN_ROUGHNESS, "metallic": 0.0}
"""The least value of each texture; the largest is 1."""

BETAS = 0.9, 0.99  # of Adam
EXPOSURE_RATE = 0.02  # of Adam at the start, in log units


class Parameters:
    """Textures of albedo, roughness and, where the plan says so, metallic; and the light's log radiance.

    Attributes:
        tensors: "albedo" (T, T, 3), "roughness" and "metallic" (T, T, 1), "log_light" (H, 2H, 3): leaves of the gradient. Where the
            photographs' exposures differ also "log_exposure" (V, 1), or (V, 3) where their white balances do, whose mean over the
            views is kept at 0, as ``Scene.exposures_differ`` says: they and the light share a factor that images cannot tell.
        observed: (T, T) bool, texels that some training view sees, in a pixel that its mask does not leave out.
        optimizer: Adam, one group a tensor.
        multigrid: Its steps at coarser scales.
        scale_ambiguity: The step along the colour that albedo and light share, which images hardly tell.
    """

    def __init__(self, problem: Problem, settings: FitSettings) -> None:
        plan, t, device = problem.plan, problem.plan.texture, problem.device
        self.observed = observed_texels(problem)
        self.tensors = {
            "albedo": torch.full((t, t, 3), settings.albedo_initial, device=device),
            "roughness": torch.full((t, t, 1), settings.roughness_initial, device=device),
            "log_light": torch.zeros(plan.light_height, 2 * plan.light_height, 3, device=device),
        }
        if plan.metallic:
            self.tensors["metallic"] = torch.full((t, t, 1), settings.metallic_initial, device=device)
        images = dict(self.tensors)
        if problem.scene.exposures_differ:
            channels = 3 if problem.scene.white_balances_differ else 1
            self.tensors["log_exposure"] = torch.zeros(problem.gbuffer.shape[0], channels, device=device)
        for tensor in self.tensors.values():
            tensor.requires_grad_(True)
        self._settings, self._turning = settings, problem.scene.turning
        self._rates = [getattr(settings.rates, name.removeprefix("log_"), EXPOSURE_RATE) for name in self.tensors]
        self._multigrid_rates = {name: getattr(settings.multigrid_rates, name.removeprefix("log_")) for name in images}
        groups = [{"params": [p], "lr": rate} for p, rate in zip(self.tensors.values(), self._rates, strict=True)]
        self.optimizer = torch.optim.Adam(groups, betas=BETAS, fused=True)
        self._alone: dict[str, Tensor] = {}
        self.multigrid = MultigridSteps(images, BETAS, wrapped=["log_light"])
        self.scale_ambiguity = ScaleAmbiguityStep(self.tensors["albedo"], self.tensors["log_light"], self.observed)

    def material(self, *, detached: bool = False) -> Material:
        """The textures as a material, through which gradients flow unless ``detached``."""
        return Material(**{name: t.detach() if detached else t for name, t in self.tensors.items() if name in LEAST})

    def alone(self, name: str) -> Tensor:
        """The texture ``name`` for a loss that moves single texels alone: multigrid and scale-ambiguity steps do not see it.

        Of a step the last call counts.
        """
        self._alone[name] = self.tensors[name].detach().requires_grad_(True)
        return self._alone[name]

    @property
    def gradients(self) -> dict[str, Tensor]:
        """After a backward pass: by tensor, what single texels of it follow."""
        found = {name: tensor.grad for name, tensor in self.tensors.items() if tensor.grad is not None}
        for name, texture in self._alone.items():
            if texture.grad is not None:
                found[name] = found[name] + texture.grad if name in found else texture.grad
        return found

    def clear(self) -> None:
        """Forget all gradients."""
        self._alone.clear()
        self.optimizer.zero_grad(set_to_none=True)

    @property
    def exposures(self) -> Tensor | None:
        """The factors (V, 1 or 3) of the photographs, through which gradients flow; None where they are known to be the same."""
        return torch.exp(self.tensors["log_exposure"]) if "log_exposure" in self.tensors else None

    def light(self, *, uniform: float | None = None) -> SampledLight:
        """The light, without gradient unless ``uniform``, the share of its samples spread over the sphere, is given."""
        log_light = self.tensors["log_light"]
        if uniform is None:
            return SampledLight.of(torch.exp(log_light.detach()), turning=self._turning)
        return SampledLight.of(torch.exp(log_light), uniform_fraction=uniform, turning=self._turning)

    def recovered(self, *, final: bool) -> tuple[Material, Tensor]:
        """Copies of the textures, and radiance (H, 2H, 3). ``final``: texels that no view sees are filled from their neighbours."""
        textures = {name: p.detach().clone() for name, p in self.tensors.items() if name in LEAST}
        if final:
            textures = {name: fill_unobserved(texture, self.observed) for name, texture in textures.items()}
        return Material(**textures), torch.exp(self.tensors["log_light"].detach())

    def frozen(self, step: int, steps: int) -> list[str]:
        """The tensors that are not optimised yet in ``step`` of ``steps``."""
        starts = {"albedo": self._settings.albedo_start, "log_light": 0.0, "log_exposure": 0.0}
        return [name for name in self.tensors if step < starts.get(name, self._settings.roughness_start) * steps]

    def descend(self, step: int, steps: int) -> bool:
        """Take ``step`` of ``steps`` along the gradients, back into valid values; whether the scale-ambiguity step was blocked."""
        settings, frozen = self._settings, self.frozen(step, steps)
        fall = settings.rates.final ** (step / max(steps - 1, 1))
        for group, rate in zip(self.optimizer.param_groups, self._rates, strict=True):
            group["lr"] = rate * fall
        blocked = False
        if settings.rates.scale_ambiguity and "albedo" not in frozen and step >= settings.scale_ambiguity_start * steps:
            blocked = self.scale_ambiguity(settings.rates.scale_ambiguity * fall)
        shared, single = {name: tensor.grad for name, tensor in self.tensors.items()}, self.gradients
        for name, tensor in self.tensors.items():  # the backward pass has computed those of what is frozen all the same
            tensor.grad = None if name in frozen else single.get(name)
        self.optimizer.step()
        self.multigrid({name: rate * fall for name, rate in self._multigrid_rates.items() if name not in frozen}, shared)
        with torch.no_grad():  # projected onto the valid range, so that no clamp in the model can kill a gradient
            for name, least in LEAST.items():
                if name in self.tensors:
                    self.tensors[name].clamp_(least, 1)
            if "log_exposure" in self.tensors:
                self.tensors["log_exposure"] -= self.tensors["log_exposure"].mean(0)
        return blocked

    @property
    def optimisers(self) -> dict[str, Optimizer]:
        """What a checkpoint must keep beside the tensors: what the optimisers remember."""
        return {"texels": self.optimizer, "multigrid": self.multigrid.optimizer, "scale_ambiguity": self.scale_ambiguity.optimizer}


def observed_texels(problem: Problem) -> Tensor:
    """(T, T) bool, the texels that some training view sees, in a pixel that its mask does not leave out."""
    gbuffer, size = problem.gbuffer, problem.plan.texture
    observed = torch.zeros(size, size, dtype=torch.bool, device=problem.device)
    parts = (gbuffer.face, gbuffer.barycentric, problem.photographs.left_out)
    for face, barycentric, left_out in zip(*(each.split(PIXELS_AT_ONCE) for each in parts), strict=True):
        hit = (face >= 0) & ~left_out[:, None]
        seen = problem.renderer.surface.uv(face[hit].long(), barycentric[hit])
        observed |= splat(seen, seen.new_zeros(len(seen), 0), size)[1] > 0
    return observed
