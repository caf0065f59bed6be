"""Nanoseconds a ray on one thread: Embree one ray after another, Embree by our packets, Warp's BVH on the CPU.

    python benchmarks/rays.py [--scenes hat ship] [--rounds 9]

The rays are those of an optimisation step, 4096 random pixels x 32 samples: shadow rays, as many from one point as were drawn
for it and count, and the nearest hits of those by the BRDF that the object blocks, as indirect light asks for them. "one by
one" is embreex's own ``rtcore_scene.EmbreeScene.run``, whose arrays are made off the clock, in the order of ours. Cases are
taken in turns; the clock is the CPU time of the process.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from benchmarks.stage import TrueScene
from benchmarks.work_precision.precision import time_in_turns
from ia_bench.light.latlong import SampledLight
from ia_bench.render.gbuffer import SurfacePoints
from ia_bench.render.rays import EmbreeRays, WarpRays
from ia_bench.render.renderer import Renderer

PIXELS, SAMPLES, VIEWS, SIZE = 4096, 32, 20, 128  # as in gradient_step.py
WARM_UP = 2
CASES = ("one by one", "packets", "Warp")


class Recorded(Renderer):
    """A renderer that keeps what its shadows were asked: origins (N, 3), directions (N, K, 3), and which (N, K)."""

    asked: tuple[Tensor, Tensor, Tensor] | None = None
    onto_object: tuple[Tensor, Tensor] | None = None

    def blocked(self, points: SurfacePoints, direction: Tensor, asked: Tensor) -> Tensor:
        """See :meth:`ia_bench.render.renderer.Renderer.blocked`."""
        blocked = super().blocked(points, direction, asked)
        origin = self.surface.lifted(points)
        self.asked = origin, direction.clone(), asked.clone()
        by_brdf = blocked.clone()
        by_brdf[:, : direction.shape[1] // 2] = False
        self.onto_object = origin[torch.nonzero(by_brdf)[:, 0]], direction[by_brdf]
        return blocked


def rays_of_a_step(stage: TrueScene) -> Recorded:
    """All that a step asks of the mesh."""
    recorded = Recorded(stage.geometry.surface, stage.geometry.rays)
    gbuffer, generator = stage.gbuffer(stage.cameras(VIEWS, SIZE)), torch.Generator().manual_seed(0)
    pixels = torch.randint(len(gbuffer.pixel), (PIXELS,), generator=generator)
    light = SampledLight.of(stage.light, uniform_fraction=0.2)
    recorded.render_pixels(gbuffer, pixels, stage.material, light, SAMPLES, generator)
    return recorded


def measure(stage: TrueScene, rounds: int) -> dict[str, dict[str, np.ndarray]]:
    """Nanoseconds a ray (rounds,) of every case, by kind of ray."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    mesh, recorded = stage.scene.expect_mesh(), rays_of_a_step(stage)
    assert recorded.asked is not None
    assert recorded.onto_object is not None
    origin, direction, asked = recorded.asked
    flat = origin[:, None].expand_as(direction)[asked].numpy(), direction[asked].numpy()
    onto = recorded.onto_object
    onto_arrays = tuple(values.numpy() for values in onto)
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
    packets, warp = EmbreeRays(mesh), WarpRays(mesh, torch.device("cpu"))
    found: dict[str, dict[str, np.ndarray]] = {}
    kinds: dict[str, tuple[int, tuple[Callable[[int], object], ...]]] = {
        "shadow ray": (
            int(asked.sum()),
            (
                lambda _: scene.run(*flat, query="OCCLUDED"),
                lambda _: packets.occluded(origin, direction, asked),
                lambda _: warp.occluded(origin, direction, asked),
            ),
        ),
        "nearest hit": (
            len(onto[0]),
            (
                lambda _: scene.run(*onto_arrays, query="INTERSECT", output=True),
                lambda _: packets.intersect(*onto),
                lambda _: warp.intersect(*onto),
            ),
        ),
    }
    for kind, (count, cases) in kinds.items():
        times = time_in_turns(dict(zip(CASES, cases, strict=True)), rounds, WARM_UP)
        found[f"{kind}, {count} of them"] = {name: 1e9 * np.asarray(times[name][1]) / count for name in CASES}
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["hat", "ship"], help="shipped scenes")
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    print("| scene | ray | by | ns a ray, least | median | median, times packets |")
    print("| :--- | :--- | :--- | ---: | ---: | ---: |")
    for name in arguments.scenes:
        for kind, cases in measure(TrueScene.of(name, light_rows=128, threads=1), arguments.rounds).items():
            for case, values in cases.items():
                ratio = np.median(values) / np.median(cases["packets"])
                cells = f"{values.min():.0f} | {np.median(values):.0f} | {ratio:.2f}"
                print(f"| {name} | {kind} | {case} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
