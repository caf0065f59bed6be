"""One optimisation step (image and gradients of albedo, roughness and light), ours beside Mitsuba 3's, in the same run.

    python benchmarks/optimisation_step.py            # ours, compiled and eager
    python benchmarks/optimisation_step.py --mitsuba  # and Mitsuba's (pip install mitsuba; libLLVM, e.g. Debian's libllvm19)

A step is 4096 pixels of a 128 x 128 view stack x 32 samples, shadowed, light and BRDF sampling with the balance
heuristic, on a mesh of 22 500 triangles, 512 x 512 textures and a 128 x 256 light. Mitsuba renders whole views, so its
time is given per million samples whose camera ray hits the object, and so is ours. Times of a machine differ from run to
run; the ratio of one run is what to quote, on a busy machine that of CPU times with `--threads 1` (threads that wait for
each other also count as busy).
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh

from ia_bench.material.textures import Material
from ia_bench.render.gbuffer import GBuffer, SurfaceInterpolator, trace_gbuffer
from ia_bench.render.rays import EmbreeRays
from ia_bench.render.renderer import Light, Renderer
from ia_bench.render.visibility import TracedShadows
from ia_bench.scenes.scene import Camera, Mesh

PIXELS, SAMPLES, TEXTURE, LIGHT_ROWS, SIZE, DISTANCE, FOCAL = 4096, 32, 512, 128, 128, 4.5, 200.0
WARM_UP, STEPS = 5, 20


def make_mesh() -> Mesh:
    """A flattened sphere through a ring, with some shadow of its own and random UV."""
    sphere = trimesh.creation.icosphere(subdivisions=5)
    sphere.apply_scale([1.0, 1.0, 0.6])
    solid = trimesh.util.concatenate([sphere, trimesh.creation.torus(1.2, 0.2)])
    uv = np.random.default_rng(0).random((len(solid.vertices), 2), dtype=np.float32)
    arrays = solid.vertices.astype(np.float32), solid.faces.astype(np.int32), solid.vertex_normals.astype(np.float32)
    return Mesh(*arrays, uv)


def pose(angle: float) -> np.ndarray:
    """Camera-to-world of a camera that looks at the origin from above."""
    eye = DISTANCE * np.array([0.9 * math.cos(angle), 0.9 * math.sin(angle), 0.43])
    back = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :4] = np.stack([right, np.cross(back, right), back, eye], 1)
    return matrix


def time_interleaved(steps: dict[str, Callable[[int], None]]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Wall and CPU seconds of STEPS steps of every case, taken in turns, so that a busy machine slows all of them alike."""
    for step in steps.values():
        for number in range(WARM_UP):  # compiles
            step(number)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in steps}
    for number in range(STEPS):
        for name, step in steps.items():
            wall, cpu = time.perf_counter(), time.process_time()
            step(WARM_UP + number)
            times[name].append((time.perf_counter() - wall, time.process_time() - cpu))
    return {name: tuple(np.array(pairs).T) for name, pairs in times.items()}


def our_step(mesh: Mesh, rays: EmbreeRays, gbuffer: GBuffer, shading: str) -> Callable[[int], None]:
    """A step of ours, as the two-stage trainer makes it but for the optimiser."""
    surface = SurfaceInterpolator(mesh, torch.device("cpu"))
    renderer = Renderer(surface, TracedShadows(rays, surface.offset), shading=shading)
    log_light = torch.zeros(LIGHT_ROWS, 2 * LIGHT_ROWS, 3, requires_grad=True)
    albedo = torch.full((TEXTURE, TEXTURE, 3), 0.5, requires_grad=True)
    roughness = torch.full((TEXTURE, TEXTURE, 1), 0.5, requires_grad=True)
    generator = torch.Generator().manual_seed(0)

    def step(_: int) -> None:
        pixels = torch.randint(len(gbuffer.pixel), (PIXELS,), generator=generator)
        light = Light.of(torch.exp(log_light))
        rendered = renderer.render_pixels(gbuffer, pixels, Material(albedo, roughness), light, SAMPLES, generator)
        (rendered.radiance - 0.3).abs().mean().backward()
        albedo.grad = roughness.grad = log_light.grad = None

    return step


def mitsuba_step(mesh: Mesh, threads: int) -> tuple[Callable[[int], None], float]:
    """A step of Mitsuba's `direct` integrator, 4 + 4 samples, and how many of its samples hit the object."""
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", "libLLVM.so.19.1")
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    import drjit as dr

    dr.set_thread_count(threads)
    shape = mi.Mesh("object", len(mesh.vertices), len(mesh.faces), has_vertex_texcoords=True)
    buffers = mi.traverse(shape)
    buffers["vertex_positions"], buffers["faces"] = mesh.vertices.ravel(), mesh.faces.astype(np.uint32).ravel()
    buffers["vertex_texcoords"] = mesh.uv.ravel()
    buffers.update()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.ply"
        shape.write_ply(str(path))

        def grey(*size: int) -> dict[str, object]:
            return {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(np.full(size, 0.5, np.float32))}

        bsdf = {"type": "principled", "base_color": grey(TEXTURE, TEXTURE, 3), "roughness": grey(TEXTURE, TEXTURE, 1)}
        sensor = {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(SIZE / 2 / FOCAL)),
            "to_world": mi.ScalarTransform4f().look_at(list(pose(0.0)[:3, 3]), [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent"},
        }
        light = mi.Bitmap(np.full((LIGHT_ROWS, 2 * LIGHT_ROWS, 3), 1.0, np.float32))
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct", "bsdf_samples": 4, "emitter_samples": 4, "hide_emitters": True},
                "sensor": sensor,
                "light": {"type": "envmap", "bitmap": light},
                "object": {"type": "ply", "filename": str(path), "bsdf": {**bsdf, "specular": 0.5}},
            }
        )
    parameters = mi.traverse(scene)
    names = [k for k, _ in parameters if k.endswith(("base_color.data", "roughness.data")) or k == "light.data"]
    covered = float((np.array(mi.render(scene, spp=1)).sum(-1) > 0).mean())
    spp = max(1, round(PIXELS * SAMPLES / (SIZE * SIZE * covered * 8)))

    def step(number: int) -> None:
        for name in names:
            parameters[name] = type(parameters[name])(dr.detach(parameters[name]))
            dr.enable_grad(parameters[name])
        parameters.update()
        dr.backward(dr.mean(dr.abs(mi.render(scene, parameters, spp=spp, seed=number) - 0.3)))
        dr.eval(*[dr.grad(parameters[name]) for name in names])
        dr.sync_thread()

    return step, SIZE * SIZE * covered * spp * 8


def main() -> None:
    """Print one line per renderer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mitsuba", action="store_true", help="time Mitsuba 3 beside ours")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads(), help="threads of each renderer")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.use_deterministic_algorithms(True)  # as a run does it
    torch.utils.deterministic.fill_uninitialized_memory = False
    mesh = make_mesh()
    rays = EmbreeRays(mesh)
    cameras = [Camera(pose(a), (FOCAL, FOCAL), (SIZE / 2, SIZE / 2), SIZE, SIZE) for a in np.linspace(0, 6, 20)]
    gbuffer = trace_gbuffer(cameras, rays, 2, torch.device("cpu"))
    cases: dict[str, tuple[Callable[[int], None], float]] = {
        f"ours, {shading}": (our_step(mesh, rays, gbuffer, shading), PIXELS * SAMPLES) for shading in ("compiled", "eager")
    }
    if arguments.mitsuba:
        cases["Mitsuba 3"] = mitsuba_step(mesh, arguments.threads)
    times = time_interleaved({name: step for name, (step, _) in cases.items()})
    first: np.ndarray | None = None
    for name, (_, samples) in cases.items():
        medians = np.array([np.median(seconds) for seconds in times[name]])
        rates = medians / samples * 1e9
        first = rates if first is None else first
        print(
            f"{name:16s} {samples:.0f} samples a step, {1e3 * medians[0]:.1f} ms ({1e3 * times[name][0].min():.1f} at best), "
            f"CPU {1e3 * medians[1]:.1f} ms ({1e3 * times[name][1].min():.1f}); per million samples {rates[0]:.0f} ms, "
            f"CPU {rates[1]:.0f} ms: {rates[0] / first[0]:.2f} x and {rates[1] / first[1]:.2f} x the first"
        )


if __name__ == "__main__":
    main()
