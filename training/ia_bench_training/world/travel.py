"""``python -m ia_bench_training.world.travel``: a smaller world, for a machine to which little can be carried."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json
from ia_bench.common.paths import make_writable
from ia_bench.common.ranges import Number
from ia_bench_training.commands import command_of
from ia_bench_training.world.layout import ATLAS, ATLAS_LEVELS, BANKS, KINDS, LEVELS, TILE, WORLD

USAGE = """\
python -m ia_bench_training.world.travel world=FOLDER out=FOLDER [files=3] [every=3] [lights=60]

Keeps at most so many files of views of each kind, one texture in so many, in half their size, and so many procedural lights
beside the photographed ones, unfiltered. `tar cJ` of it takes some 45 MB.
"""


@dataclass(frozen=True)
class TravelRequest:
    """USAGE says what each setting is."""

    world: Path
    out: Path
    files: Number = 3
    every: Number = 3
    lights: Number = 60


def reduce(request: TravelRequest) -> None:
    """Write the smaller world. Raises InputError for one that is as small already, and where it would replace the other."""
    described = read_json(request.world / WORLD)
    if "halved" in described:
        raise InputError(
            f"{request.world}: expected a world of python -m ia_bench_training.world.make, found one that has travelled"
        )
    if request.out.resolve() == request.world.resolve():
        raise InputError(f"out: expected another folder than world={request.world}, found the same")
    make_writable(request.out, "out")
    for kind in KINDS:
        for path in sorted(request.world.glob(f"views_{kind}_*.safetensors"))[: request.files]:
            (request.out / path.name).write_bytes(path.read_bytes())
    bank = load_file(request.world / BANKS)
    real, photographed = bank["real"].tolist()
    kept = torch.cat([torch.arange(0, real, request.every), torch.arange(real, len(bank["tiles.mean"]), request.every)])
    bank["tiles.flat"] = _halved(bank["tiles.flat"], len(bank["tiles.mean"]), TILE, LEVELS, kept)
    worn = torch.arange(len(bank["atlases.mean"]))
    bank["atlases.flat"] = _halved(bank["atlases.flat"], len(worn), ATLAS, ATLAS_LEVELS, worn)
    bank["tiles.mean"], bank["chances"] = bank["tiles.mean"][kept], bank["chances"][: real : request.every]
    bank["real"] = torch.tensor([len(bank["chances"]), photographed])
    bank["lights"] = bank["lights"][: photographed + request.lights, :, :1]
    save_file({name: values.contiguous() for name, values in bank.items()}, request.out / BANKS)
    (request.out / WORLD).write_text(json.dumps(described | {"halved": 1}))


def _halved(flat: Tensor, count: int, side: int, levels: int, kept: Tensor) -> Tensor:
    """Textures without their largest version, of which these numbers (K,) are ``kept``."""
    sizes = [(side >> level) ** 2 for level in range(levels)]
    parts = flat.split([count * size for size in sizes])[1:]
    return torch.cat([part.unflatten(0, (count, -1))[kept].flatten(0, 1) for part in parts])


main = command_of(USAGE, TravelRequest, lambda request, _: reduce(request))


if __name__ == "__main__":
    sys.exit(main())
