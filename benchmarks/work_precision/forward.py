"""One view rendered in every way, error against seconds: the rows of the work-precision diagrams."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.mitsuba_scene import DirectScene
from benchmarks.reference import TorchRenderer, can_compile, fetch, shade_directions
from benchmarks.work_precision.precision import converged, log_slope, relative_rmse, time_in_turns
from benchmarks.work_precision.techniques import TECHNIQUES, technique_directions, unit_points
from ia_bench.common.errors import InputError
from ia_bench.light.environment import LatLongEnvironment
from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.readers.native import NativeReader
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, trace_gbuffer
from ia_bench.render.rays import make_rays
from ia_bench.render.renderer import Renderer
from ia_bench.runs.config import SceneConfig, resolve_scene_folder

SAMPLES = (8, 16, 32, 64, 128, 256, 512)
REPEATS = 4
REFERENCE_PARTS, REFERENCE_SAMPLES = 32, 512
MAX_LIGHT_ROWS = 128  # as in benchmarks/gradient_step.py
SIDE = 2  # points along a side of a pixel
CHUNK_SAMPLES = 2**17
PRODUCT, TORCH, MITSUBA = "renderer", "renderer (torch, compiled)", "Mitsuba 3"


@dataclass(frozen=True)
class Way:
    """One way of estimating: a key of TECHNIQUES, and a rule of placing points."""

    technique: str
    rule: str = "lattice"


WAYS: dict[str, Way] = {
    **{technique: Way(technique) for technique in TECHNIQUES},
    "MIS, independent": Way("MIS", rule="independent"),
    "MIS, stratified": Way("MIS", rule="stratified"),
}
"""What the product has not is here; "MIS" is what it does, by torch and without a compiler, to be compared with the others."""


class ForwardStage:
    """One test view of a shipped scene with its true material and light."""

    def __init__(self, name: str) -> None:
        """Raises InputError for an unknown scene and where one has no ground truth."""
        folder = resolve_scene_folder(SceneConfig(name))
        assert folder is not None
        scene = NativeReader(folder).read(truth=True)
        if scene.truth is None or scene.truth.albedo is None or scene.truth.roughness is None:
            raise InputError(f"{name}: work-precision needs the true textures")
        self.mesh, self.camera = scene.expect_mesh(), scene.test[0].camera
        roughness = torch.from_numpy(scene.truth.roughness)[..., None].float().clamp_min(MIN_ROUGHNESS)
        self.material = Material(torch.from_numpy(scene.truth.albedo).float(), roughness)
        light = LatLongEnvironment(torch.from_numpy(scene.truth.lights["train"]))
        self.light = SampledLight.of(light.latlong(min(MAX_LIGHT_ROWS, len(light.texels))))
        device = torch.device("cpu")
        self.surface, self.rays = SurfaceInterpolator(scene.expect_mesh(), device), make_rays(scene.expect_mesh(), device)
        self.gbuffer: GBuffer = trace_gbuffer([self.camera], self.rays, SIDE, device)
        self.inside = (self.gbuffer.coverage()[0] == 1).numpy()  # edges depend on the pixel filter

    def scored(self, image: np.ndarray) -> np.ndarray:
        """The pixels of an image (H, W, 3) that errors are taken over, (P, 3)."""
        return image[self.inside]

    def render(self, renderer: Renderer, samples: int, seed: int) -> np.ndarray:
        """The product's image (H, W, 3)."""
        generator = torch.Generator().manual_seed(seed)
        images = renderer.render_images(self.gbuffer, self.material, self.light, samples, generator)
        return images["radiance"][0].numpy()

    @torch.no_grad()
    def estimate(self, way: Way, samples: int, seed: int) -> np.ndarray:
        """The image (H, W, 3) of a way with ``samples`` directions a pixel, a multiple of its points times its samplers."""
        generator = torch.Generator().manual_seed(seed)
        image = torch.zeros(self.gbuffer.shape[1] * self.gbuffer.shape[2], 3)
        for chunk in torch.arange(len(self.gbuffer.pixel)).split(max(1, CHUNK_SAMPLES // samples)):
            image[self.gbuffer.pixel[chunk]] = self._pixels(way, chunk, samples, generator)
        return image.reshape(*self.gbuffer.shape[1:], 3).numpy()

    def _pixels(self, way: Way, chunk: Tensor, samples: int, generator: torch.Generator) -> Tensor:
        face, points, samplers = self.gbuffer.face[chunk], self.gbuffer.subsamples, len(TECHNIQUES[way.technique])
        hit = (face >= 0).reshape(-1)
        camera = self.gbuffer.origin[0].expand(len(hit), 3)
        surface = self.surface(face.reshape(-1).long(), self.gbuffer.barycentric[chunk].reshape(-1, 2), camera)
        count = samples // (points * samplers)
        unit = tuple(unit_points(way.rule, len(chunk), points, count, generator).reshape(-1, count, 3) for _ in range(samplers))
        roughness = fetch(self.material.roughness, surface.uv)
        direction, texel, weight = technique_directions(
            way.technique, surface.normal, surface.view, roughness, unit, self.light.sampler
        )
        blocked = Renderer(self.surface, self.rays).blocked(surface, direction, (weight[..., 0] > 0) & hit[:, None])
        diffuse, specular, _ = shade_directions(
            surface.normal,
            surface.view,
            surface.uv,
            direction,
            texel,
            weight * ~blocked[..., None],
            self.material.albedo,
            self.material.roughness,
            self.light.radiance.reshape(-1, 3),
        )
        return ((diffuse + specular) * hit[:, None]).reshape(len(chunk), points, 3).sum(1) / points


def measure(scene: str, *, threads: int, quick: bool) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of forward.csv, and the summary: floors, slopes, whether Mitsuba took part."""
    stage = ForwardStage(scene)
    renderer = Renderer(stage.surface, stage.rays)
    counts = SAMPLES[:2] if quick else SAMPLES
    parts = 4 if quick else REFERENCE_PARTS
    reference_samples = 64 if quick else REFERENCE_SAMPLES
    reference, floor = converged(
        np.stack([stage.scored(stage.render(renderer, reference_samples, 1_000_000 + part)) for part in range(parts)])
    )
    renders: dict[str, Callable[[int, int], np.ndarray]]
    renders = {name: functools.partial(stage.estimate, way) for name, way in WAYS.items()}
    renders[PRODUCT] = functools.partial(stage.render, renderer)
    if not quick and can_compile():
        renders[TORCH] = functools.partial(stage.render, TorchRenderer(renderer, compiled=True))
    references = dict.fromkeys(renders, reference)
    summary: dict[str, Any] = {"scene": scene, "reference_samples": parts * reference_samples, "floor": floor}
    try:
        other = DirectScene(stage.mesh, [stage.camera], stage.material, stage.light.radiance, threads=threads)
    except InputError as error:
        summary["left_out"] = f"{MITSUBA}: {error}"
    else:
        renders[MITSUBA] = lambda samples, seed: other.image(0, samples // other.samples_per_ray, seed)
        shots = [stage.scored(renders[MITSUBA](reference_samples, 1_000_000 + part)) for part in range(parts)]
        references[MITSUBA], summary["mitsuba_floor"] = converged(np.stack(shots))
        summary["mitsuba_difference"] = relative_rmse(references[MITSUBA], reference)
    rows = []
    for samples in counts:
        rows += _measure_count(stage, renders, references, samples, 2 if quick else REPEATS)
    summary["slopes"] = {
        name: log_slope(*zip(*_points(rows, name), strict=True)) if _points(rows, name) else None for name in renders
    }
    return rows, summary


def _points(rows: list[dict[str, Any]], name: str) -> list[tuple[float, float]]:
    return [(row["samples"], row["relative_rmse"]) for row in rows if row["case"] == name and not row["failure"]]


def _measure_count(
    stage: ForwardStage,
    renders: dict[str, Callable[[int, int], np.ndarray]],
    references: dict[str, np.ndarray],
    samples: int,
    repeats: int,
) -> list[dict[str, Any]]:
    """Rows of all cases at one number of samples, taken in turns."""
    errors: dict[str, list[float]] = {name: [] for name in renders}
    failures = dict.fromkeys(renders, "")

    def guarded(name: str) -> Callable[[int], np.ndarray | None]:
        def once(seed: int) -> np.ndarray | None:
            try:
                return renders[name](samples, seed)
            except Exception as error:  # a failure is a row of the table
                failures[name] = f"{type(error).__name__}: {error}"
                return None

        return once

    def score(name: str, image: np.ndarray | None) -> None:
        if image is None:
            return
        if not np.isfinite(image).all():
            failures[name] = f"{int((~np.isfinite(image)).sum())} values are NaN or Inf"
            return
        errors[name].append(relative_rmse(stage.scored(image), references[name]))

    times = time_in_turns({name: guarded(name) for name in renders}, repeats, 1, score)
    return [
        {
            "case": name,
            "samples": samples,
            "cpu_s": float(np.median(times[name][1])),
            "wall_s": float(np.median(times[name][0])),
            "relative_rmse": None if failures[name] else float(np.sqrt(np.mean(np.square(errors[name])))),
            "rmse_low": None if failures[name] else min(errors[name]),
            "rmse_high": None if failures[name] else max(errors[name]),
            "repeats": len(errors[name]),
            "failure": failures[name],
        }
        for name in renders
    ]
