"""``ia-bench relight RUN|ASSET --light my.hdr --out FILE``: what was recovered, under lights of your own."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ia_bench.common.arguments import Parser, at_least, number_of
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, exits, say
from ia_bench.common.machine import cores, settle_libraries
from ia_bench.common.paths import make_writable
from ia_bench.common.progress import Progress

if TYPE_CHECKING:
    from ia_bench.runs.relighting import Background

STEPS = 36  # of a turn, where the file is an animation and nobody says how many
EXAMPLES = """\
  ia-bench relight runs/hat/none-1234 --light my.hdr --out hat.png                      a still, from a held-out view
  ia-bench relight asset.glb --light a.hdr b.exr --background light --out strip.png     two lights side by side
  ia-bench relight asset.glb --light my.hdr --views orbit --turn 36 --out turning.webp  the object turns
"""


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    about = f"{__doc__.partition(': ')[2]}\n\n{EXAMPLES}"
    kind = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog="ia-bench relight", description=about, formatter_class=kind)
    parser.add_argument("what", type=Path, metavar="RUN|ASSET", help="the folder of a run, or a .glb, .gltf or .obj")
    parser.add_argument(
        "--light", nargs="+", required=True, help="lights of the run's scene, or maps, .hdr or .exr; several side by side"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".png, .webp, .gif, or .mp4 (by ffmpeg)")
    seen = "still, orbit (the object turns), test (all held-out views) or a view, as test/0001 (default: a held-out one or still)"
    parser.add_argument("--views", metavar="VIEW", help=seen)
    steps = f"pictures of a whole turn of the light, or of the object (default: 1, of .gif and .mp4 {STEPS})"
    parser.add_argument("--turn", type=at_least(1), metavar="N", help=steps)
    lasting = number_of("more than 0", lambda seconds: 0 < seconds < math.inf)
    parser.add_argument("--seconds", type=lasting, default=3.0, help="that an animation lasts (default: 3)")
    parser.add_argument("--size", type=at_least(16), default=512, help="height of a picture in pixels (default: 512)")
    parser.add_argument("--samples", type=at_least(2), default=128, help="directions of light a pixel (default: 128)")
    behind = "transparent, light or white (default: transparent; of .gif and .mp4 light)"
    parser.add_argument("--background", choices=("transparent", "light", "white"), metavar="WHAT", help=behind)
    parser.add_argument(
        "--exposure", type=_exposure, default=None, metavar="EV", help="a number; auto: nearly all of the object below white"
    )
    parser.add_argument("--scene", type=Path, help="folder of the run's scene, if it is no longer where the run found it")
    parser.add_argument("--up", choices=("y", "z"), default="y", help="the axis of an asset's file that points up (default: y)")
    parser.add_argument("--threads", type=at_least(1), default=cores(), help="CPU threads (default: all)")
    wanted = parser.parse_args(arguments)
    moving = wanted.out.suffix in (".gif", ".mp4")
    turn = wanted.turn or (STEPS if moving and wanted.views != "test" else 1)
    background: Background = wanted.background or ("light" if moving else "transparent")
    settle_libraries(wanted.threads)
    import numpy as np
    import torch

    from ia_bench.render.reconstruction import Quality
    from ia_bench.runs import relighting

    make_writable(wanted.out.parent, "--out")
    if not wanted.what.exists():
        raise InputError(f"{wanted.what}: expected the folder of a run, or a .glb, .gltf or .obj file, found none")
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    with Progress() as progress:
        scene = None
        if wanted.what.is_dir():
            found, scene = relighting.of_run(wanted.what, device, wanted.scene)
        else:
            found = relighting.of_asset(wanted.what, device, progress.note, wanted.up)
        lights = [relighting.light_called(name, scene, "--light") for name in wanted.light]
        for name, light in zip(wanted.light, lights, strict=True):
            if not light.any():
                raise InputError(f"--light={name}: expected a light, found a black map")
        views = wanted.views or (f"test/{scene.test[0].name}" if scene is not None and scene.test else relighting.STILL)
        frames = relighting.frames_of(views, turn, found.assets().mesh, scene, wanted.size)
        relighting.expect_format(wanted.out, background, frames, len(lights))
        task = progress.task("pictures", len(frames) * len(lights))
        quality = Quality(points=3, samples=wanted.samples)
        drawn = [
            relighting.draw(found, light, frames, background=background, ev=wanted.exposure, quality=quality, advance=task.advance)
            for light in lights
        ]
    side_by_side = [np.concatenate(row, 1) for row in zip(*(pictures for pictures, _ in drawn), strict=True)]
    relighting.write_animation(wanted.out, side_by_side, seconds=wanted.seconds)
    for name, (_, exposure) in zip(wanted.light, drawn, strict=True):
        say(f"{name}: exposure {exposure:+.2f} EV", sys.stdout)
    say(str(wanted.out), sys.stdout)
    return OK


def _exposure(text: str) -> float | None:
    """The EV, None for auto."""
    return None if text == "auto" else number_of("auto or a number from -64 to 64", lambda ev: abs(ev) <= 64)(text)
