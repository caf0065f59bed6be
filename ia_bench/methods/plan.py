"""What this scene needs and what it leaves out: measured before work starts, printed, stored, each overridable.

A setting that is not "auto" is taken as it is and recorded as the user's choice. Nothing here sees ground truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.machine import expect_memory
from ia_bench.material.brdf import dot, normalize
from ia_bench.methods.views import sees, spreading_order, views_needed
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, SurfacePoints
from ia_bench.render.rays import RayCaster
from ia_bench.render.renderer import samples_taken
from ia_bench.render.settings import RenderSettings
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene

PROBE_VIEWS = 8
PROBE_RAYS = 20_000
PROBE_POINTS = 2_000
PROBE_PIXELS = 4096  # of a step, or more than it has
VIEWS_A_POINT = 4  # views that show a point to the prior
SEEN_SHARE = 0.95
TEXTURE_SIZES = (64, 128, 256, 512, 1024, 2048)
LIGHT_HEIGHTS = (16, 32)  # finer lights are seen in mirrors, but the default number of steps does not learn them
POINT_SIDES = (2, 3, 4)  # points along a side of a pixel, where one is too few
PROBE_ALBEDO = 0.5  # of the object, in the probe of indirect light
MAX_BOUNCES = 4
INDIRECT_SHARE = 0.005  # of the light that is seen: less than this is left out (a fit to 33 dB is off by 2 %)
NORMAL_ERROR = 0.1  # accepted root mean square error of a pixel's mean normal, misses counting as zero normals


@dataclass(frozen=True)
class Decision:
    """One choice: ``what`` was chosen, the ``value`` taken, ``why``, and the measurement behind it (None: the user's choice)."""

    what: str
    value: Any
    why: str
    measured: dict[str, float] | None
    left_out: str | None = None  # what the choice saves, None if nothing is left out

    @property
    def line(self) -> str:
        """The choice in one printable line."""
        return f"plan: {self.what} = {self.value}: {self.why}"


@dataclass(frozen=True)
class Plan:
    """Resolved settings of one run."""

    samples: int
    subsamples: int
    texture: int
    light_height: int
    shadows: str
    bounces: int = 0
    metallic: bool = False
    decisions: list[Decision] = field(default_factory=list)

    def lines(self) -> list[str]:
        """One printable line per decision."""
        return [decision.line for decision in self.decisions]

    def record(self) -> dict[str, list[Any]]:
        """The ``plan`` entry of metrics.json."""
        needed = [{"what": d.what, "value": d.value, "why": d.why, "measured": d.measured} for d in self.decisions]
        left_out = [{"what": d.left_out, "why": d.why, "measured": d.measured} for d in self.decisions if d.left_out is not None]
        return {"needed": needed, "left_out": left_out}


@torch.no_grad()
def make_plan(scene: Scene, stage: Stage, settings: RenderSettings) -> Plan:
    """Measure a few training views on the ``stage`` of the scene's mesh, and decide."""
    probe = _probe(scene, stage)
    decisions = []
    for name, decide in DECISIONS.items():
        chosen = getattr(settings, name)
        decisions.append(decide(probe) if chosen == "auto" else Decision(f"render.{name}", chosen, "set by the user", None))
    value = {name: decision.value for name, decision in zip(DECISIONS, decisions, strict=True)}
    _check_memory(settings.samples, **{name: value[name] for name in ("subsamples", "texture", "light_height")})
    return Plan(samples=settings.samples, decisions=decisions, **value)


@torch.no_grad()
def choose_prior_views(scene: Scene, stage: Stage, setting: int | str) -> Decision:
    """How many training views a prior is asked about: the ``setting``, or with "auto" as many as show the surface often enough."""
    what = "prior.views"
    if setting == "all":
        return Decision(what, "all", "every training view is looked at", None)
    if setting != "auto":
        return Decision(what, setting, "set by the user", None)
    probe, total = _probe(scene, stage), len(scene.train)
    order = spreading_order(scene, total)
    points = probe.points(PROBE_POINTS, probe.generator())
    cameras = [scene.train[view].camera for view in order]
    seen = sees(cameras, points.position, points.geometric, probe.rays, probe.surface.offset)
    count = views_needed(seen, VIEWS_A_POINT, SEEN_SHARE)
    measured = {"views": float(total), "seen_by_all_views": float(seen.sum(1).double().mean())}
    measured["seen_by_chosen_views"] = float(seen[:, :count].sum(1).double().mean())
    why = (
        f"{count} of {total} views show {100 * SEEN_SHARE:.0f} % of the surface {VIEWS_A_POINT} times or as often as all do "
        f"(a point {measured['seen_by_chosen_views']:.1f} times in the mean, {measured['seen_by_all_views']:.1f} with all)"
    )
    return Decision(what, count, why, measured, left_out=f"the prior's look at {total - count} views" if count < total else None)


def _probe(scene: Scene, stage: Stage) -> _Probe:
    """Raises InputError where no camera sees the mesh."""
    step = max(1, len(scene.train) // PROBE_VIEWS)
    some, every = ([view.camera for view in views] for views in (scene.train[::step], scene.train))
    probe = _Probe(scene, stage.surface, stage.rays, stage.gbuffer(some, 2))
    if not probe.sees:
        probe = replace(probe, gbuffer=stage.gbuffer(every, 2))
    if not probe.sees:
        raise InputError(
            f"{scene.source}: no training camera sees the mesh: expected transform_matrix to be camera-to-world in the "
            "OpenGL convention (the camera looks along its -z axis, +y is up), in the units of mesh.ply"
        )
    return probe


@dataclass(frozen=True)
class _Probe:
    """What the plan measures on: some training views of the scene, 2 x 2 points a pixel."""

    scene: Scene
    surface: SurfaceInterpolator
    rays: RayCaster
    gbuffer: GBuffer

    @property
    def sees(self) -> bool:
        """Whether any of the views shows the mesh."""
        return bool((self.gbuffer.face[:, 0] >= 0).any())

    @cached_property
    def footprint(self) -> dict[str, Tensor]:
        """How far apart two neighbouring points of a pixel are, see :func:`_footprints`."""
        return _footprints(self)

    def generator(self) -> torch.Generator:
        """Of one measurement's own draws."""
        return torch.Generator(device=self.gbuffer.face.device).manual_seed(0)

    def points(self, count: int, generator: torch.Generator) -> SurfacePoints:
        """``count`` points that the cameras see, with replacement."""
        gbuffer = self.gbuffer
        chosen = torch.nonzero(gbuffer.face[:, 0] >= 0)[:, 0]
        chosen = chosen[torch.randint(len(chosen), (count,), generator=generator, device=chosen.device)]
        return self.surface(gbuffer.face[chosen, 0].long(), gbuffer.barycentric[chosen, 0], gbuffer.seen_from(chosen))


def _check_memory(samples: int, *, subsamples: int, texture: int, light_height: int) -> None:
    """Raise InputError for sizes that this machine cannot hold; measured on fits, rounded up."""
    taken = samples_taken(samples, subsamples**2)
    asked = f"render.samples={samples}" + (f" (at least 2 x {subsamples} x {subsamples})" if taken > samples + 2 else "")
    for name, size in RenderSettings(texture=texture, light_height=light_height).memory().items():
        expect_memory(f"render.{name}={texture if name == 'texture' else light_height}", size)
    expect_memory(asked, 300 * PROBE_PIXELS * taken)


def _footprints(probe: _Probe) -> dict[str, Tensor]:
    """How far apart two neighbouring points of a pixel (half a pixel) are: in UV, and in angle of normal and mirror direction."""
    gbuffer = probe.gbuffer
    both = (gbuffer.face[:, :2] >= 0).all(1)
    camera = gbuffer.seen_from(both)
    a, b = (probe.surface(gbuffer.face[both, i].long(), gbuffer.barycentric[both, i], camera) for i in (0, 1))
    extent = (a.position - b.position).norm(dim=-1)
    continuous = extent < 4 * extent.median()  # a jump to another part of the object is no footprint
    uv = (a.uv - b.uv).norm(dim=-1)
    same_island = continuous & (uv < 4 * uv[continuous].median())
    mirror_a, mirror_b = (normalize(2 * dot(p.normal, p.view) * p.normal - p.view) for p in (a, b))
    return {
        "uv": 2 * uv[same_island],
        "normal": 2 * _angle(a.normal, b.normal)[continuous],
        "mirror": 2 * _angle(mirror_a, mirror_b)[continuous],
    }


def _angle(a: Tensor, b: Tensor) -> Tensor:
    return 2 * torch.asin((0.5 * (a - b).norm(dim=-1)).clamp(max=1))


def _closest_quarter(footprint: Tensor) -> float:
    """The lower quartile of (N,) values, N >= 1; torch.quantile takes no more than 16 million."""
    return float(footprint.sort().values[(len(footprint) - 1) // 4])


def _shadows(probe: _Probe) -> Decision:
    what, generator = "render.shadows", probe.generator()
    points = probe.points(PROBE_RAYS, generator)
    directions = _cosine_directions(points.geometric, generator)
    share = float(probe.rays.occluded(points.position + probe.surface.offset * points.geometric, directions).double().mean())
    measured = {"occluded_share": share, "probe_rays": float(PROBE_RAYS)}
    if share == 0:
        why = f"none of {PROBE_RAYS} cosine-distributed probe rays hit the object: no shadows to trace"
        return Decision(what, "none", why, measured, left_out="shadow rays")
    return Decision(what, "traced", f"{100 * share:.1f} % of cosine-distributed probe rays hit the object itself", measured)


def _bounces(probe: _Probe) -> Decision:
    seen = _light_by_bounces(probe)
    if not sum(seen):
        raise InputError(
            f"mesh: expected light from outside to reach what the cameras see, found none on {PROBE_RAYS} paths (triangles that "
            "face inward, or cameras inside a closed mesh?); render.bounces=0 leaves the probe out"
        )
    beyond = {count: sum(seen[count + 1 :]) / sum(seen) for count in range(MAX_BOUNCES + 1)}
    measured = {"indirect_share": beyond[0], "share_beyond_one": beyond[1], "probe_paths": float(PROBE_RAYS)}
    chosen = next(count for count in beyond if beyond[count] < INDIRECT_SHARE or count == MAX_BOUNCES)
    why = (
        f"with albedo {PROBE_ALBEDO} under an even light {100 * beyond[0]:.1f} % of what is seen has bounced off the object before"
        + (f", {100 * beyond[chosen]:.1f} % more than {chosen} times" if chosen else "")
    )
    left_out = "indirect light" if chosen == 0 else f"more than {chosen} bounces" if chosen < MAX_BOUNCES else None
    return Decision("render.bounces", chosen, why, measured, left_out=left_out)


def _light_by_bounces(probe: _Probe) -> list[float]:
    """Light that reaches the camera after 0, 1, ... MAX_BOUNCES + 1 bounces before the point that is seen; relative to each other.

    Paths from points that are seen, on until they leave the object, under light 1 from everywhere. Backs of triangles are black.
    """
    surface, generator = probe.surface, probe.generator()
    points = probe.points(PROBE_RAYS, generator)
    position, normal = points.position, points.geometric
    seen = []
    for bounces in range(MAX_BOUNCES + 2):
        direction = _cosine_directions(normal, generator)
        face, barycentric, _ = probe.rays.intersect(position + surface.offset * normal, direction)
        hit = face >= 0
        seen.append(PROBE_ALBEDO**bounces * float((~hit).double().sum()))
        normal, position = surface.geometry(face[hit], barycentric[hit])
        front = dot(normal, direction[hit])[:, 0] < 0
        normal, position = normal[front], position[front]
    return seen


def _cosine_directions(normal: Tensor, generator: torch.Generator) -> Tensor:
    """A cosine-distributed direction around each unit normal, (N, 3)."""
    scattered = torch.randn(normal.shape, generator=generator, device=normal.device)
    return normalize(normal + normalize(scattered))


def _subsamples(probe: _Probe) -> Decision:
    what, normals = "render.subsamples", probe.footprint["normal"]
    hits = (probe.gbuffer.face >= 0).float().mean(1)
    edge = float((hits < 1).double().mean())
    bend = math.degrees(float(normals.mean())) if len(normals) else 0.0
    spread = _normal_spread(probe)
    error = {side: normal_error(spread, side) for side in POINT_SIDES}
    measured = {"edge_pixel_share": edge, "mean_normal_change_degrees": bend, "normal_error_of_2_x_2": error[2]}
    why = f"{100 * edge:.1f} % of pixels are partly covered, normals change by {bend:.1f} degrees across a pixel"
    if edge < 0.02 and bend < 1.0:
        return Decision(what, 1, why, measured, left_out="pixel sub-samples")
    chosen = next((side for side in POINT_SIDES if error[side] <= NORMAL_ERROR), POINT_SIDES[-1])
    why += f"; the mean normal of {chosen} x {chosen} points is {error[chosen]:.3f} off"
    left_out = f"more than {chosen} x {chosen} points a pixel" if chosen < POINT_SIDES[-1] else None
    return Decision(what, chosen, why, measured, left_out=left_out)


def _normal_spread(probe: _Probe) -> float:
    """Root mean square deviation of the normals of a pixel's points from their mean, misses counting as zero normals."""
    gbuffer, hit = probe.gbuffer, probe.gbuffer.face >= 0
    camera = gbuffer.seen_from()[:, None].expand(*hit.shape, 3)
    normal = torch.zeros(*hit.shape, 3, device=hit.device)
    normal[hit] = probe.surface(gbuffer.face[hit].long(), gbuffer.barycentric[hit], camera[hit]).normal
    return float((normal - normal.mean(1, keepdim=True)).square().sum(-1).mean().sqrt())


def normal_error(spread: float, side: int) -> float:
    """Expected error (RMS) of the mean normal of ``side`` x ``side`` points of a pixel, from the spread of 2 x 2 points.

    On the shipped scenes, against 8 x 8 points, the error of 2 x 2 is a third of their spread (0.27 to 0.38) and falls as
    the power -1.4 of the side: faster than that of random points, slower than that of a smooth integrand.
    """
    return spread / 3 * (2 / side) ** 1.4


def _texture(probe: _Probe) -> Decision:
    what, across = "render.texture", probe.footprint["uv"]
    if len(across) == 0:
        return Decision(what, TEXTURE_SIZES[0], "no pixel has two neighbouring points on one UV island", None)
    pixel = _closest_quarter(across)  # the closer quarter of the surface decides
    size = next((s for s in TEXTURE_SIZES if pixel * s >= 1), TEXTURE_SIZES[-1])
    why = f"a pixel spans {pixel * size:.2f} texels at {size} (closest quarter of the surface)"
    left_out = f"textures above {size} texels" if size < TEXTURE_SIZES[-1] else None
    return Decision(what, size, why, {"pixel_footprint_uv": pixel}, left_out=left_out)


def _light(probe: _Probe) -> Decision:
    what, mirrored = "render.light_height", probe.footprint["mirror"]
    if len(mirrored) == 0:
        return Decision(what, LIGHT_HEIGHTS[0], "no pixel has two neighbouring points", None)
    angle = _closest_quarter(mirrored)
    rows = math.pi / max(angle, 1e-6)
    size = min(LIGHT_HEIGHTS, key=lambda height: abs(math.log2(height / rows)))
    why = f"mirror directions of a pixel span {math.degrees(angle):.1f} degrees, a texel {180 / size:.1f}"
    capped = rows > math.sqrt(2) * LIGHT_HEIGHTS[-1]
    if capped:
        why += "; a fit of the default length is worse with finer lights"
    left_out = f"light rows above {size}" if capped or size < LIGHT_HEIGHTS[-1] else None
    return Decision(what, size, why, {"mirror_footprint_degrees": math.degrees(angle)}, left_out=left_out)


def _metallic(probe: _Probe) -> Decision:
    metallic = probe.scene.metallic
    why = f"the scene's description names {'' if metallic else 'no '}parts of metal"
    left_out = None if metallic else "a metallic texture"
    return Decision("render.metallic", metallic, why, {"metallic": float(metallic)}, left_out=left_out)


DECISIONS: dict[str, Callable[[_Probe], Decision]] = {
    "shadows": _shadows,
    "bounces": _bounces,
    "subsamples": _subsamples,
    "texture": _texture,
    "light_height": _light,
    "metallic": _metallic,
}
"""What is measured, by the setting of the renderer that it decides where that is "auto"."""
