"""What this scene needs and what it leaves out: measured before work starts, printed, stored, each overridable.

A setting that is not "auto" is taken as it is and recorded as the user's choice. Nothing here sees ground truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.machine import expect_memory
from ia_bench.material.brdf import dot, normalize
from ia_bench.methods.photographs import spreading_order, views_needed
from ia_bench.render.agreement import USUAL
from ia_bench.render.gbuffer import GBuffer, SurfacePoints, sees
from ia_bench.render.renderer import samples_taken
from ia_bench.render.settings import RenderSettings
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene, View

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
    """One choice.

    Attributes:
        value: What is taken.
        why: The reason, for the user.
        measured: What the reason rests on; None for the user's choice.
        left_out: What the choice saves, None if nothing is left out.
        what: The setting.
    """

    value: Any
    why: str
    measured: dict[str, float] | None = None
    left_out: str | None = None
    what: str = ""

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
    metallic: bool | None = False  # None where the scene's description does not say, and nobody has found out
    decisions: list[Decision] = field(default_factory=list)

    def record(self) -> dict[str, list[Any]]:
        """The ``plan`` entry of metrics.json."""
        needed = [{"what": d.what, "value": d.value, "why": d.why, "measured": d.measured} for d in self.decisions]
        left_out = [{"what": d.left_out, "why": d.why, "measured": d.measured} for d in self.decisions if d.left_out is not None]
        return {"needed": needed, "left_out": left_out}


@torch.no_grad()
def make_plan(scene: Scene, stage: Stage, settings: RenderSettings) -> Plan:
    """Measure a few training views on the ``stage`` of the scene's mesh, and decide.

    Raises InputError for sizes that this machine cannot hold.
    """
    probe, decisions = _Probe.of(scene, stage), {}
    for name, decide in DECISIONS.items():
        setting = getattr(settings, name)
        decision = decide(probe) if setting == "auto" else Decision(setting, "as it was set")
        decisions[name] = replace(decision, what=f"render.{name}")
    value = {name: decision.value for name, decision in decisions.items()}
    chosen, side = replace(settings, **value), int(value["subsamples"])
    for name, size in chosen.memory().items():  # measured on fits, rounded up
        expect_memory(f"render.{name}={getattr(chosen, name)}", size, stage.device.type)
    taken = samples_taken(settings.samples, side**2)
    more = f" (at least 2 x {side} x {side})" if taken > settings.samples + 2 else ""
    expect_memory(f"render.samples={settings.samples}{more}", 300 * PROBE_PIXELS * taken, stage.device.type)
    return Plan(samples=settings.samples, decisions=list(decisions.values()), **value)


@torch.no_grad()
def choose_prior_views(scene: Scene, stage: Stage, setting: int | str) -> Decision:
    """How many training views a prior is asked about: the ``setting``, or with "auto" as many as show the surface often enough."""
    what = "prior.views"
    if setting != "auto":
        return Decision(setting, "every training view is looked at" if setting == "all" else "as it was set", what=what)
    probe, total = _Probe.of(scene, stage), len(scene.train)
    cameras = [scene.train[view].camera for view in spreading_order(scene, total)]
    points = probe.points(PROBE_POINTS, probe.generator())
    seen = sees(cameras, points.position, points.geometric, stage.rays, stage.surface.offset)
    count = views_needed(seen, VIEWS_A_POINT, SEEN_SHARE)
    by_all, by_chosen = (float(some.sum(1).double().mean()) for some in (seen, seen[:, :count]))
    measured = {"views": float(total), "seen_by_all_views": by_all, "seen_by_chosen_views": by_chosen}
    why = (
        f"{count} of {total} views show {100 * SEEN_SHARE:.0f} % of the surface {VIEWS_A_POINT} times or as often as all do "
        f"(a point {by_chosen:.1f} times in the mean, {by_all:.1f} with all)"
    )
    return Decision(count, why, measured, f"the prior's look at {total - count} views" if count < total else None, what)


@dataclass(frozen=True)
class _Probe:
    """What the plan measures on: some training views of the scene, 2 x 2 points a pixel."""

    scene: Scene
    stage: Stage
    gbuffer: GBuffer

    @classmethod
    def of(cls, scene: Scene, stage: Stage) -> _Probe:
        """A few views, or all where those show nothing. Raises InputError where no view shows the mesh."""
        choices: tuple[Sequence[View], ...] = (scene.train[:: max(1, len(scene.train) // PROBE_VIEWS)], scene.train)
        for views in choices:
            gbuffer = stage.gbuffer([view.camera for view in views], 2)
            if bool((gbuffer.face[:, 0] >= 0).any()):
                return cls(scene, stage, gbuffer)
        raise InputError(f"{scene.source}: no training camera sees the mesh: {USUAL}")

    def generator(self) -> torch.Generator:
        """The generator of one measurement's own draws."""
        return torch.Generator(device=self.gbuffer.face.device).manual_seed(0)

    def points(self, count: int, generator: torch.Generator) -> SurfacePoints:
        """``count`` points that the cameras see, with replacement."""
        chosen = torch.nonzero(self.gbuffer.face[:, 0] >= 0)[:, 0]
        return self.surface(chosen[torch.randint(len(chosen), (count,), generator=generator, device=chosen.device)], 0)

    def surface(self, pixels: Tensor, point: int) -> SurfacePoints:
        """The surface at one of the four points of pixels that show it there."""
        gbuffer = self.gbuffer
        face, barycentric = gbuffer.face[pixels, point].long(), gbuffer.barycentric[pixels, point]
        return self.stage.surface(face, barycentric, gbuffer.seen_from(pixels))

    def closest_quarter(self, what: str) -> float | None:
        """The lower quartile of a footprint, where the closer part of the surface decides; None where there is none."""
        values = self.footprint[what]  # torch.quantile takes no more than 16 million
        return float(values.sort().values[(len(values) - 1) // 4]) if len(values) else None

    @cached_property
    def footprint(self) -> dict[str, Tensor]:
        """How far apart two neighbouring points of a pixel are: in UV, and in angle of normal and of mirror direction."""
        both = torch.nonzero((self.gbuffer.face[:, :2] >= 0).all(1))[:, 0]
        a, b = self.surface(both, 0), self.surface(both, 1)
        extent = (a.position - b.position).norm(dim=-1)
        continuous = extent < 4 * extent.median()  # a jump to another part of the object is no footprint
        uv = (a.uv - b.uv).norm(dim=-1)
        same_island = continuous & (uv < 4 * uv[continuous].median())
        mirror_a, mirror_b = (normalize(2 * dot(p.normal, p.view) * p.normal - p.view) for p in (a, b))
        normal, mirror = _angle(a.normal, b.normal), _angle(mirror_a, mirror_b)
        # The points are half a pixel apart.
        return {"uv": 2 * uv[same_island], "normal": 2 * normal[continuous], "mirror": 2 * mirror[continuous]}


def _angle(a: Tensor, b: Tensor) -> Tensor:
    return 2 * torch.asin((0.5 * (a - b).norm(dim=-1)).clamp(max=1))


def _shadows(probe: _Probe) -> Decision:
    generator, stage = probe.generator(), probe.stage
    points = probe.points(PROBE_RAYS, generator)
    directions = _cosine_directions(points.geometric, generator)
    origin = points.position + stage.surface.offset * points.geometric
    share = float(stage.rays.occluded(origin, directions).double().mean())
    measured = {"occluded_share": share, "probe_rays": float(PROBE_RAYS)}
    if share == 0:
        why = f"none of {PROBE_RAYS} cosine-distributed probe rays hit the object: no shadows to trace"
        return Decision("none", why, measured, "shadow rays")
    return Decision("traced", f"{100 * share:.1f} % of cosine-distributed probe rays hit the object itself", measured)


def _bounces(probe: _Probe) -> Decision:
    """By paths from points that are seen, on until they leave the object, under light 1 from everywhere. Backs are black."""
    stage, generator, seen = probe.stage, probe.generator(), []
    points = probe.points(PROBE_RAYS, generator)
    position, normal = points.position, points.geometric
    for bounces in range(MAX_BOUNCES + 2):  # before the point that is seen; the light that reaches the camera, in any unit
        direction = _cosine_directions(normal, generator)
        face, barycentric, _ = stage.rays.intersect(position + stage.surface.offset * normal, direction)
        hit = face >= 0
        seen.append(PROBE_ALBEDO**bounces * float((~hit).double().sum()))
        normal, position = stage.surface.geometry(face[hit], barycentric[hit])
        front = dot(normal, direction[hit])[:, 0] < 0
        normal, position = normal[front], position[front]
    if not sum(seen):
        raise InputError(
            f"mesh: expected light from outside to reach what the cameras see, found none on {PROBE_RAYS} paths (triangles that "
            "face inward, or cameras inside a closed mesh?); render.bounces=0 leaves the probe out"
        )
    beyond = {count: sum(seen[count + 1 :]) / sum(seen) for count in range(MAX_BOUNCES + 1)}
    measured = {"indirect_share": beyond[0], "share_beyond_one": beyond[1], "probe_paths": float(PROBE_RAYS)}
    chosen = next(count for count in beyond if beyond[count] < INDIRECT_SHARE or count == MAX_BOUNCES)
    bounced = f"{100 * beyond[0]:.1f} % of what is seen has bounced off the object before"
    why = f"with albedo {PROBE_ALBEDO} under an even light {bounced}"
    if chosen:
        why += f", {100 * beyond[chosen]:.1f} % more than {chosen} times"
    left_out = "indirect light" if chosen == 0 else f"more than {chosen} bounces" if chosen < MAX_BOUNCES else None
    return Decision(chosen, why, measured, left_out)


def _cosine_directions(normal: Tensor, generator: torch.Generator) -> Tensor:
    """A cosine-distributed direction around each unit normal, (N, 3)."""
    return normalize(normal + normalize(torch.randn(normal.shape, generator=generator, device=normal.device)))


def _subsamples(probe: _Probe) -> Decision:
    normals, error = probe.footprint["normal"], _normal_errors(probe)
    edge = float(((probe.gbuffer.face >= 0).float().mean(1) < 1).double().mean())
    bend = math.degrees(float(normals.mean())) if len(normals) else 0.0
    measured = {"edge_pixel_share": edge, "mean_normal_change_degrees": bend, "normal_error_of_2_x_2": error[2]}
    why = f"{100 * edge:.1f} % of pixels are partly covered, normals change by {bend:.1f} degrees across a pixel"
    if edge < 0.02 and bend < 1.0:
        return Decision(1, why, measured, "pixel sub-samples")
    chosen = next((side for side in POINT_SIDES if error[side] <= NORMAL_ERROR), POINT_SIDES[-1])
    why += f"; the mean normal of {chosen} x {chosen} points is {error[chosen]:.3f} off"
    return Decision(chosen, why, measured, f"more than {chosen} x {chosen} points a pixel" if chosen < POINT_SIDES[-1] else None)


def _normal_errors(probe: _Probe) -> dict[int, float]:
    """Expected RMS error of a pixel's mean normal by the number of points along its side; misses count as zero normals."""
    gbuffer, hit = probe.gbuffer, probe.gbuffer.face >= 0
    camera = gbuffer.seen_from()[:, None].expand(*hit.shape, 3)
    normal = torch.zeros(*hit.shape, 3, device=hit.device)
    normal[hit] = probe.stage.surface(gbuffer.face[hit].long(), gbuffer.barycentric[hit], camera[hit]).normal
    spread = float((normal - normal.mean(1, keepdim=True)).square().sum(-1).mean().sqrt())
    # Measured on the shipped scenes against 8 x 8 points: a third of the spread with 2 x 2, falling as the power -1.4.
    return {side: spread / 3 * (2 / side) ** 1.4 for side in (1, *POINT_SIDES)}


def _texture(probe: _Probe) -> Decision:
    pixel = probe.closest_quarter("uv")
    if pixel is None:
        return Decision(TEXTURE_SIZES[0], "no pixel has two neighbouring points on one UV island")
    size = next((s for s in TEXTURE_SIZES if pixel * s >= 1), TEXTURE_SIZES[-1])
    why = f"a pixel spans {pixel * size:.2f} texels at {size} (closest quarter of the surface)"
    left_out = f"textures above {size} texels" if size < TEXTURE_SIZES[-1] else None
    return Decision(size, why, {"pixel_footprint_uv": pixel}, left_out)


def _light(probe: _Probe) -> Decision:
    angle = probe.closest_quarter("mirror")
    if angle is None:
        return Decision(LIGHT_HEIGHTS[0], "no pixel has two neighbouring points")
    rows = math.pi / max(angle, 1e-6)
    size = min(LIGHT_HEIGHTS, key=lambda height: abs(math.log2(height / rows)))
    why = f"mirror directions of a pixel span {math.degrees(angle):.1f} degrees, a texel {180 / size:.1f}"
    capped = rows > math.sqrt(2) * LIGHT_HEIGHTS[-1]
    if capped:
        why += "; a fit of the default length is worse with finer lights"
    left_out = f"light rows above {size}" if capped or size < LIGHT_HEIGHTS[-1] else None
    return Decision(size, why, {"mirror_footprint_degrees": math.degrees(angle)}, left_out)


def _metallic(probe: _Probe) -> Decision:
    metallic = probe.scene.metallic
    if metallic is None:
        return Decision(None, "the scene's description does not say whether there is metal", {}, "a metallic texture")
    why = f"the scene's description names {'' if metallic else 'no '}parts of metal"
    return Decision(metallic, why, {"metallic": float(metallic)}, None if metallic else "a metallic texture")


DECISIONS: dict[str, Callable[[_Probe], Decision]] = {
    "shadows": _shadows,
    "bounces": _bounces,
    "subsamples": _subsamples,
    "texture": _texture,
    "light_height": _light,
    "metallic": _metallic,
}
"""What is measured, by the setting of the renderer that it decides where that is "auto"."""
