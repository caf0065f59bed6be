"""The three phases of TensoIR, and what they recover."""

from __future__ import annotations

import torch
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.light.environment import Environment
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.descent import Descent, Phase
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.reconstruction import Quality
from ia_bench.scenes.color import linear_to_srgb
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.common.shaded import ShadedReconstruction, Shader, bake, part_of
from ia_bench_baselines.common.spherical_gaussians.fit import fit_light
from ia_bench_baselines.common.spherical_gaussians.lobes import SphericalGaussianEnvironment
from ia_bench_baselines.common.spherical_gaussians.sampling import draw_directions
from ia_bench_baselines.tensoir.method import TensoirOptions
from ia_bench_baselines.tensoir.model import Tensoir, arriving_light
from ia_bench_baselines.tensoir.shading import reflect

LAST_RATE = 0.1  # to which all learning rates fall over a phase of both heads
NEARBY = 0.01  # standard deviation of the distance over which material is to be smooth; the object's box is 2 wide
FULL_SAMPLES = 128  # of a quality for which all directions are drawn
POINTS_AT_ONCE = 256  # of a render: each looks into directions of its own


class TensoirFit:
    """The losses of TensoIR on one problem.

    Attributes:
        model: What is trained.
    """

    def __init__(self, problem: Problem, options: TensoirOptions, seed: int) -> None:
        """The model as it starts, drawn from ``seed``."""
        self._stage, self._options = problem.stage, options
        self._side = problem.plan.subsamples
        self._pixels = TrainingPixels(problem, self._side)
        vertices = torch.from_numpy(problem.scene.expect_mesh().vertices)
        corners = torch.stack([vertices.amin(0), vertices.amax(0)]).to(problem.device)
        self.model = Tensoir(options, corners, torch.Generator(device=problem.device).manual_seed(derive_seed(seed, "weights")))

    def phases(self) -> list[Phase]:
        """The radiance head; both heads; both heads on the fine tensor."""
        options, model = self._options, self.model

        def adam(tensor: list[torch.nn.Parameter], *, light: bool) -> torch.optim.Optimizer:
            groups = [{"params": tensor, "lr": options.tensor_rate}, {"params": model.networks(), "lr": options.network_rate}]
            if light:
                groups.append({"params": list(model.light.parameters()), "lr": options.light_rate})
            return torch.optim.Adam(groups, betas=(0.9, 0.99))

        def decay(share: float) -> float:
            return LAST_RATE**share

        coarse, fine = model.tensor.coarse(), model.tensor.fine()
        return [
            Phase("radiance", options.radiance_steps, self._radiance_loss, lambda: adam(coarse, light=False), scored=False),
            Phase("coarse", options.coarse_steps, self._joint_loss, lambda: adam(coarse, light=True), rate=decay),
            Phase(
                "fine",
                options.fine_steps,
                self._joint_loss,
                lambda: adam(fine, light=True),
                rate=decay,
                begin=lambda _: model.tensor.refine(),
            ),
        ]

    def _radiance_loss(self, step: int, generator: torch.Generator) -> Tensor:
        chosen = self._pixels.draw(self._options.radiance_pixels, generator)
        points, model = self._pixels.points(chosen), self.model
        seen = model.radiance(model.features(model.local(points.position)), points.view)
        return self._errors(seen, chosen).square().mean() + self._options.variation_weight * model.tensor.variation()

    def _joint_loss(self, step: int, generator: torch.Generator) -> Tensor:
        options, model = self._options, self.model
        chosen = self._pixels.draw(options.pixels, generator)
        points = self._pixels.points(chosen)
        local = model.local(points.position)
        features = model.features(local)
        albedo, roughness = model.material(features, local)

        # ---- images of both heads ------------------------------------------------------------------------------
        seen = self._errors(model.radiance(features, points.view), chosen).square().mean()
        twice = part_of(points, torch.arange(len(albedo), device=chosen.device).repeat(2))
        colour, rough = albedo.repeat(2, 1), roughness.repeat(2, 1)
        count = max(3, options.directions // 2 // self._side**2)
        drawn = draw_directions(model.light.lobes(), twice, rough.detach(), count, generator)
        shaded = reflect(twice, colour, rough, drawn.direction, drawn.weight, arriving_light(self._stage, twice, drawn, model))
        first, second = (self._errors(half, chosen) for half in shaded.chunk(2))

        # ---- smoothness ----------------------------------------------------------------------------------------
        near = local + NEARBY * torch.randn(local.shape, generator=generator, device=local.device)
        others = model.material(model.features(near), near)
        smooth = sum(relative_change(a, b) for a, b in zip((albedo, roughness), others, strict=True))
        return seen + options.brdf_weight * (first * second).mean() + options.smooth_weight * smooth

    def _errors(self, radiance: Tensor, chosen: Tensor) -> Tensor:
        """The errors in sRGB of linear radiance (N S, 3) of the S points of each of the N chosen pixels.

        Of two independent renders the mean product of errors is the squared error without the variance of either: noise would
        otherwise be paid for by a rougher material and a smoother light.
        """
        radiance = radiance.unflatten(0, (len(chosen), -1)).mean(1)
        target = self._pixels.target(chosen, radiance).clamp(0, 1)  # the original takes images of 8 bits
        return linear_to_srgb(radiance.clamp(0, 1)) - linear_to_srgb(target)


def relative_change(first: Tensor, second: Tensor) -> Tensor:
    """The sum over channels of ((a - b) / max(a, b))^2 of positive values (N, C), in the mean over the points."""
    return ((first - second) / torch.maximum(first, second).clamp_min(1e-6)).square().sum(-1).mean()


def fit(problem: Problem, options: TensoirOptions, *, seed: int, monitor: Monitor) -> Result:
    """See :class:`ia_bench_baselines.tensoir.method.Tensoir`."""
    with problem.costs.exclude("bake"):
        trained = TensoirFit(problem, options, seed)
    size = problem.plan.texture

    def recovered() -> ShadedReconstruction:
        return reconstruction(problem, trained.model, size, options)

    return Descent(trained.model, trained.phases(), seed=seed, monitor=monitor).run(recovered)


def reconstruction(problem: Problem, model: Tensoir, size: int, options: TensoirOptions) -> ShadedReconstruction:
    """What the material's head found, as textures of ``size`` and as its own renders; see ``TensoirOptions.head``."""

    def material_at(position: Tensor) -> Tensor:
        local = model.local(position)
        return torch.cat(model.material(model.features(local), local), 1)

    albedo, roughness = (part.contiguous() for part in bake(problem.stage, size, material_at).split((3, 1), -1))
    with torch.no_grad():
        lobes = model.light.lobes()

    def head(points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
        return model.radiance(model.features(model.local(points.position)), points.view)

    def shader(novel: Environment | None, quality: Quality) -> Shader:
        if novel is None and options.head == "radiance":
            return head
        light = lobes if novel is None else fit_light(novel, options.lobes)
        share = min(quality.samples / FULL_SAMPLES, 1)  # what is asked for in passing, as for a curve, is drawn with fewer
        count = max(1, round(share * options.rendered_directions / quality.points**2))  # of a point
        generator = torch.Generator(device=problem.device).manual_seed(quality.seed)

        def radiance(points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
            local = model.local(points.position)
            colour, rough = model.material(model.features(local), local)
            colour = colour if albedo_scale is None else colour * albedo_scale.to(colour)
            drawn = draw_directions(light, points, rough, count, generator)
            arriving = arriving_light(problem.stage.apart, points, drawn, model if novel is None else None)
            return reflect(points, colour, rough, drawn.direction, drawn.weight, arriving)

        return radiance

    renderer = "sums over directions of spherical Gaussians"
    return ShadedReconstruction(
        problem.stage,
        Material(albedo, roughness),
        renderer=renderer if options.head == "brdf" else f"radiance head; {renderer} under novel lights",
        environment=SphericalGaussianEnvironment(lobes),
        shader=shader,
        at_once=POINTS_AT_ONCE,
    )
