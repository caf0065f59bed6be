"""The three phases of NeILF++, and what they recover."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ia_bench.common.seeds import derive_seed
from ia_bench.light.environment import Environment
from ia_bench.material.textures import Material
from ia_bench.methods.contract import Monitor, Problem, Result
from ia_bench.methods.descent import Descent, Phase
from ia_bench.methods.photographs import stacked
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.reconstruction import Quality
from ia_bench.scenes.color import linear_to_srgb
from ia_bench_baselines.common.pixels import TrainingPixels
from ia_bench_baselines.common.shaded import ShadedReconstruction, Shader, bake, part_of
from ia_bench_baselines.neilfpp.fields import BRIGHTEST, HashGrid, Neilf
from ia_bench_baselines.neilfpp.losses import scharr_edges, second_hits, smoothness, trace_loss
from ia_bench_baselines.neilfpp.method import NeilfppOptions
from ia_bench_baselines.neilfpp.shading import quadrature, reflect

RATE_DROP = 0.2  # of the learning rate, after each third of the joint phase
FULL_SAMPLES = 128  # of a quality for which all directions are drawn
POINTS_AT_ONCE = 512  # of a render: each needs as many evaluations of the incident light as there are directions above it


class NeilfFit:
    """The losses of NeILF++ on one problem.

    Attributes:
        neilf: What is trained.
    """

    def __init__(self, problem: Problem, options: NeilfppOptions, seed: int) -> None:
        """The fields as they start; networks draw their weights from ``seed``."""
        self._stage, self._options = problem.stage, options
        self._pixels = TrainingPixels(problem, problem.plan.subsamples)
        images = stacked(problem.scene.train, "image").to(problem.device)
        self._edges = scharr_edges(images).reshape(-1)[self._pixels.gbuffer.pixel[self._pixels.entries]]
        vertices = torch.from_numpy(problem.scene.expect_mesh().vertices)
        corners = torch.stack([vertices.amin(0), vertices.amax(0)]).to(problem.device)
        generator = torch.Generator(device=problem.device).manual_seed(derive_seed(seed, "weights"))
        self.neilf = Neilf(options, corners, float(self._pixels.radiance.median()), generator)

    def phases(self) -> list[Phase]:
        """The surface light field; material and incident light; everything."""
        options, neilf = self._options, self.neilf
        optics = [neilf.material_grid, neilf.material_head, neilf.incident_field]
        outgoing = [neilf.outgoing_grid, neilf.outgoing_head]

        def adam(parts: list[torch.nn.Module]) -> Callable[[], torch.optim.Optimizer]:
            groups = [
                {"params": list(part.parameters()), "lr": options.grid_rate if isinstance(part, HashGrid) else options.rate}
                for part in parts
            ]
            return lambda: torch.optim.AdamW(groups, eps=1e-12, weight_decay=0.0)

        return [
            Phase("surface_light", options.surface_light_steps, self._surface_light_loss, adam(outgoing), scored=False),
            Phase("material", options.material_steps, lambda _, generator: self._loss(generator, held=True), adam(optics)),
            Phase(
                "joint",
                options.joint_steps,
                lambda _, generator: self._loss(generator, held=False),
                adam(optics + outgoing),
                rate=lambda share: RATE_DROP ** int(3 * share),
            ),
        ]

    def _surface_light_loss(self, step: int, generator: torch.Generator) -> Tensor:
        chosen = self._pixels.draw(self._options.surface_light_pixels, generator)
        return self._outgoing_error(self._pixels.points(chosen), chosen)

    def _outgoing_error(self, points: SurfacePoints, chosen: Tensor) -> Tensor:
        return self._error(self.neilf.outgoing(self.neilf.local(points.position), points.view), chosen)

    def _error(self, radiance: Tensor, chosen: Tensor) -> Tensor:
        """The mean absolute error of radiance (N S, 3) of the S points of each of the chosen pixels, as an image has it."""
        seen = radiance.unflatten(0, (len(chosen), -1)).mean(1)
        return (encoded(seen) - encoded(self._pixels.target(chosen, seen))).abs().mean()

    def _loss(self, generator: torch.Generator, *, held: bool) -> Tensor:
        """All of a step; ``held``: the surface light field is not trained."""
        options, neilf = self._options, self.neilf
        chosen = self._pixels.draw(options.pixels, generator)
        points = self._pixels.points(chosen)
        local = neilf.local(points.position).requires_grad_()
        material = neilf.material(local)

        # ---- image: light arrives at a pixel, and is reflected by each of its points --------------------------
        each = len(local) // len(chosen)
        first = torch.arange(0, len(local), each, device=local.device)
        around = quadrature(part_of(points, first), material[1][first].detach(), options.directions, options.glossy, generator)
        directions = around.of_points()
        facing = directions.repeat_interleave(each, 0)
        above = ((facing @ points.normal[..., None])[..., 0] > 0).unflatten(0, (-1, each)).any(1)
        pixel, which = torch.nonzero(above, as_tuple=True)
        incident = neilf.incident(local.detach()[first], around.directions, pixel, around.row[pixel, which])
        arriving = torch.zeros_like(directions).index_put((pixel, which), incident).repeat_interleave(each, 0)
        seen = reflect(points, material, facing, around.weight.repeat_interleave(each, 0), arriving)
        loss = self._error(seen, chosen)

        # ---- light that comes from the object itself -----------------------------------------------------------
        some = torch.randint(len(pixel), (options.traced,), generator=generator, device=pixel.device)
        start, along = first[pixel[some]], directions[pixel[some], which[some]]
        hit, position = second_hits(self._stage, points.position[start], points.geometric[start], along)
        loss = loss + options.trace_weight * trace_loss(neilf, incident[some[hit]], position, along[hit], held=held)

        # ---- priors, and the surface light field from images ---------------------------------------------------
        _, roughness, metallic = material
        edges = self._edges[chosen].repeat_interleave(each)
        loss = loss + options.metallic_weight * metallic.mean()
        loss = loss + options.smooth_weight * smoothness(local, roughness, metallic, edges)
        return loss if held else loss + self._outgoing_error(points, chosen) / BRIGHTEST


def encoded(radiance: Tensor) -> Tensor:
    """Radiance as the original compares it for images of 8 bits: at most 1, in sRGB."""
    return linear_to_srgb(radiance.clamp(0, 1))


def fit(problem: Problem, options: NeilfppOptions, *, seed: int, monitor: Monitor) -> Result:
    """See :class:`ia_bench_baselines.neilfpp.method.Neilfpp`."""
    with problem.costs.exclude("bake"):
        fields = NeilfFit(problem, options, seed)
    size = problem.plan.texture

    def recovered() -> ShadedReconstruction:
        return reconstruction(problem, fields.neilf, size, options)

    return Descent(fields.neilf, fields.phases(), seed=seed, monitor=monitor).run(recovered)


def reconstruction(problem: Problem, neilf: Neilf, size: int, options: NeilfppOptions) -> ShadedReconstruction:
    """Textures of ``size`` that the reference renderer draws under novel lights, and the fields' own view synthesis."""
    texels = bake(problem.stage, size, lambda position: torch.cat(neilf.material(neilf.local(position)), 1))
    colour, roughness, metallic = (part.contiguous() for part in texels.split((3, 1, 1), -1))

    def shader(novel: Environment | None, quality: Quality) -> Shader | None:
        if novel is not None:
            return None
        generator = torch.Generator(device=problem.device).manual_seed(quality.seed)
        share = min(quality.samples / FULL_SAMPLES, 1)  # for a curve, fewer will do
        count, glossy = (
            max(4, round(share * wanted / quality.points**2)) for wanted in (options.rendered_directions, options.rendered_glossy)
        )

        def radiance(points: SurfacePoints, albedo_scale: Tensor | None) -> Tensor:
            seen = torch.zeros_like(points.normal)
            parts = -(-len(seen) // POINTS_AT_ONCE)
            for first in range(parts):  # points of a pixel are neighbours: each is to have directions of its own
                part = torch.arange(first, len(seen), parts, device=seen.device)
                seen[part] = shade(neilf, part_of(points, part), count, glossy, generator, albedo_scale)
            return seen

        return radiance

    return ShadedReconstruction(
        problem.stage,
        Material(colour, roughness, metallic),
        renderer="neural incident light",
        environment=None,
        shader=shader,
    )


def shade(
    neilf: Neilf, points: SurfacePoints, count: int, glossy: int, generator: torch.Generator, albedo_scale: Tensor | None
) -> Tensor:
    """Radiance (N, 3) that the fields send from points toward the camera, by ``count`` directions and ``glossy`` ones."""
    local = neilf.local(points.position)
    colour, roughness, metallic = neilf.material(local)
    colour = colour if albedo_scale is None else colour * albedo_scale.to(colour)
    around = quadrature(points, roughness, count, glossy, generator)
    directions = around.of_points()
    point, which = torch.nonzero((directions @ points.normal[..., None])[..., 0] > 0, as_tuple=True)
    incident = neilf.incident(local, around.directions, point, around.row[point, which])
    arriving = torch.zeros_like(directions).index_put((point, which), incident)
    return reflect(points, (colour, roughness, metallic), directions, around.weight, arriving)
