"""``python -m ia_bench_training.world.held_out``: photographs of the held-out real objects, on which training is judged.

The benchmark's own renderer makes them: every shadow traced, light between the parts of an object, a layered coat.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.machine import settle_libraries
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Number
from ia_bench.light.environment import turned
from ia_bench.light.latlong import SampledLight
from ia_bench.material.brdf import MIN_ROUGHNESS
from ia_bench.material.textures import Material
from ia_bench.render.reconstruction import Assets
from ia_bench.render.renderer import texture_images
from ia_bench.render.stage import Stage
from ia_bench.scenes.exr import read_light
from ia_bench_training.cameras import draw_camera
from ia_bench_training.commands import command_of
from ia_bench_training.draws import about_z
from ia_bench_training.real_sources import closed_set
from ia_bench_training.render import MIN_COVERAGE
from ia_bench_training.shards import ShardInfo, read_info, shard_path, write_shard
from ia_bench_training.world.views import load_mesh

USAGE = """\
python -m ia_bench_training.world.held_out out=FOLDER [real=results/real] [size=64] [samples=256]

Photographs every held-out real object of datasets/real/sources.toml under each held-out light, once, into one shard, as
python -m ia_bench_training.single_view and validation=FOLDER of training take it. A shard that is there is kept.
"""
SEED = 2**31  # of the shard: no training set has it
POINTS, BOUNCES, ATLAS = 2, 2, 64
RADIANCE = 0.3


@dataclass(frozen=True)
class HeldOutRequest:
    """Where to, from which data, how large and how finely."""

    out: Path
    real: Path = Path("results/real")
    size: Number = 64
    samples: Number = 256


def photograph(asset: Assets, light: np.ndarray, rng: np.random.Generator, size: int, samples: int) -> dict[str, Tensor]:
    """One view of an object under a light that is turned about the vertical: tensors of ia_bench_training.shards, (S, S, C)."""
    centre = (asset.mesh.vertices.min(0) + asset.mesh.vertices.max(0)) / 2
    vertices = asset.mesh.vertices - centre
    mesh = replace(asset.mesh, vertices=(vertices / np.linalg.norm(vertices, axis=1).max()).astype(np.float32))
    stage, maps = Stage(mesh, torch.device("cpu")), (asset.albedo, asset.roughness, asset.metallic)
    albedo, roughness, metallic = (None if each is None else torch.from_numpy(np.atleast_3d(each)).float() for each in maps)
    assert albedo is not None
    assert roughness is not None
    material = Material(albedo, roughness.clamp_min(MIN_ROUGHNESS), metallic)
    texels = torch.from_numpy(turned(light, about_z(2 * np.pi * rng.integers(64) / 64))).float()
    renderer = stage.renderer(bounces=BOUNCES, coat="layered", atlas_size=ATLAS)
    while True:
        gbuffer = stage.gbuffer([draw_camera(rng, mesh.vertices, size, cropped=0)], POINTS)
        coverage = gbuffer.coverage()[..., None]
        if float(coverage.mean()) > MIN_COVERAGE:
            break
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    found = renderer.render_images(gbuffer, material, SampledLight.of(texels), samples, generator)
    scale = RADIANCE * float(coverage.sum()) / float(found["radiance"].mean(-1).sum())
    unknown = torch.zeros_like(found["radiance"])
    return {
        "image": torch.cat([scale * found["radiance"], coverage], -1)[0].clamp(max=6e4),
        "albedo": texture_images(stage.surface, gbuffer, albedo)[0],
        "specular": (scale * found["specular"][0]).clamp(max=6e4),
        "normal": unknown[0],  # networks are judged without geometry
        "visibility": unknown[0, ..., :1],
    }


def make_held_out(request: HeldOutRequest, progress: Progress) -> None:
    """Photograph what is held out. Raises InputError where that is there in another size, and where a file of it is absent."""
    make_writable(request.out, "out")
    if (path := shard_path(request.out, 0)).is_file():
        if (found := read_info(path).size) != request.size:
            raise InputError(f"{path}: expected images of size={request.size}, found {found}; give another out= folder")
        return
    names = closed_set("held_out")
    for name in names:
        if not (request.real / name).is_file():
            raise InputError(f"{request.real / name}: expected a file of `make real-data`, found none")
    lights = [_halved(read_light(request.real / name)) for name in names if name.startswith("lights/")]
    objects, images = [name for name in names if name.startswith("objects/")], list[dict[str, Tensor]]()
    task = progress.task("held-out objects", len(objects))
    for number, name in enumerate(objects):
        asset = load_mesh(request.real / name)
        if asset is None:
            progress.note(f"{name}: left out, for its textures repeat")
        else:
            for k, light in enumerate(lights):
                images.append(photograph(asset, light, np.random.default_rng([SEED, number, k]), request.size, request.samples))
        task.advance()
    if not images:
        raise InputError(f"{request.real}: expected held-out objects whose textures do not repeat, found none")
    tensors = {name: torch.stack([image[name] for image in images]) for name in images[0]}
    write_shard(path, tensors, ShardInfo(seed=SEED, first=0, count=len(images), size=request.size))


def _halved(radiance: np.ndarray) -> np.ndarray:
    height, width, _ = radiance.shape
    return radiance.reshape(height // 2, 2, width // 2, 2, 3).mean((1, 3)).astype(np.float32)


main = command_of(USAGE, HeldOutRequest, make_held_out)


if __name__ == "__main__":
    settle_libraries(1)
    sys.exit(main())
