"""``python -m ia_bench_baselines.yi.data``: renders objects of the procedural generator, each under eight grey lights.

Object k is that of image 8 k of the generator's seed, with its camera and materials; its lights are new draws of the generator's
kinds of light. They are made grey, because the low rank of chromaticities holds for lights of one colour only.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ia_bench.common.arguments import read_arguments
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, command
from ia_bench.common.machine import settle_libraries
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress
from ia_bench.common.ranges import Count, Number
from ia_bench_baselines.common.pictures import SIDE
from ia_bench_training.generate import render_relit
from ia_bench_training.lights import Light, draw_light
from ia_bench_training.render import VIEWS
from ia_bench_training.shading import DirectLight
from ia_bench_training.shards import CHANNELS, ShardInfo, load_shard, read_info, write_shard

USAGE = """\
python -m ia_bench_baselines.yi.data out=FOLDER [objects=300] [seed=24] [compiled=true] [threads=1]

Renders objects of the procedural generator, each from one camera under eight grey lights, into FOLDER/relit_*.safetensors
(16 objects each). Finished files are kept, so that the command can be stopped and repeated, or repeated with more objects.
"""
LIGHTS = VIEWS  # of one object
OBJECTS = 16  # of one file
PATTERN = "relit_[0-9]*.safetensors"
_RELIT = 24  # purpose of the random streams of lights; the generator's own are 1 and 2


@dataclass(frozen=True)
class RelitRequest:
    """Which objects.

    Attributes:
        out: Folder of the files; made where it is missing.
        objects: How many objects the folder shall hold.
        seed: Of the generator: which of its endless sets.
        compiled: Whether shading is compiled, which takes a while once and needs a C++ compiler.
        threads: Of the CPU.
    """

    out: Path
    objects: Number = 300
    seed: Count = 24
    compiled: bool = True
    threads: Number = 1


def grey(light: Light) -> Light:
    """The light with every radiance replaced by its mean over the channels."""
    colourless = {
        name: values.mean(-1, keepdim=True).expand_as(values).contiguous()
        for name, values in (("radiance", light.radiance), ("emission", light.emission))
    }
    return replace(light, **colourless)


def render_object(seed: int, number: int, size: int, direct: DirectLight) -> dict[str, Tensor]:
    """Object ``number`` of a seed under its eight lights: the generator's tensors by name, (8, S, S, C) float16."""
    lights = [grey(draw_light(np.random.default_rng([seed, _RELIT, number, k]))) for k in range(LIGHTS)]
    return render_relit(seed, VIEWS * number, lights, size, direct)


def make_data(request: RelitRequest, progress: Progress) -> None:
    """Render what the folder lacks. Raises InputError where it holds more, or objects of another seed: training takes all of it."""
    make_writable(request.out, "out")
    for path in sorted(request.out.glob(PATTERN)):
        info = read_info(path)
        last = (info.first + info.count) // LIGHTS
        if info.seed != request.seed or last > request.objects:
            expected = f"expected at most objects={request.objects} of seed={request.seed}"
            raise InputError(f"{path}: {expected}, found {last} of seed {info.seed}. Give another out= folder")
    settle_libraries(request.threads)
    direct = DirectLight(compiled=request.compiled)
    task = progress.task("objects", request.objects)
    for first in range(0, request.objects, OBJECTS):
        count = min(OBJECTS, request.objects - first)
        path = request.out / f"relit_{first // OBJECTS:05d}.safetensors"
        info = ShardInfo(seed=request.seed, first=LIGHTS * first, count=LIGHTS * count, size=SIDE)
        if not (path.is_file() and load_shard(path)[1] == info):
            parts = [render_object(request.seed, first + k, SIDE, direct) for k in range(count)]
            write_shard(path, {name: torch.cat([part[name] for part in parts]) for name in CHANNELS}, info)
        task.advance(count)


def load_objects(folder: Path) -> dict[str, Tensor]:
    """All objects of a folder: the generator's tensors by name, (K, 8, S, S, C) float16. Raises InputError where there are none."""
    paths = sorted(folder.glob(PATTERN))
    if not paths:
        raise InputError(f"{folder}: expected relit_*.safetensors (python -m ia_bench_baselines.yi.data makes them), found none")
    shards = [load_shard(path)[0] for path in paths]
    return {name: torch.cat([shard[name] for shard in shards]).unflatten(0, (-1, LIGHTS)) for name in CHANNELS}


def _make(arguments: Sequence[str]) -> int:
    with Progress() as progress:
        make_data(read_arguments(RelitRequest, arguments), progress)
    return OK


if __name__ == "__main__":
    sys.exit(command(lambda: USAGE, _make, None))
