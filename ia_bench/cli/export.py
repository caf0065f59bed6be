"""``ia-bench export SCENE OUT``: a scene after its capture in the layout of another program, or its photographs for a network."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ia_bench.common.arguments import Parser
from ia_bench.common.atomic_file import whole_folder
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.exit_codes import OK, exits, say
from ia_bench.common.paths import make_writable
from ia_bench.runs.composition import compose, scene_setting, setting
from ia_bench.runs.config import expect_outside
from ia_bench.scenes.scene import Mesh

NO_MESH = Mesh(*(np.zeros((0, count), kind) for count, kind in ((3, "f4"), (3, "i4"), (3, "f4"), (2, "f4"))))
USAGE = "ia-bench export SCENE OUT (--format NAME | --for prior) [SETTING=VALUE ...]"
EXAMPLES = """\
SCENE is a name or a folder; SETTING=VALUE is any of a run's that decide what is photographed: reader=..., capture.views=8.

  ia-bench export hat OUT --format nerfstudio           a folder that others' code reads, and our reader=nerfstudio
  ia-bench export hat OUT --for prior --size 512        photographs for a network; prior=files takes its predictions back

Formats: native, nerfstudio, blender-nerf, tensoir, nerfactor, synthetic4relight, stanford_orb, neilf, dtu, colmap, llff
"""


@exits()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    about = __doc__.partition(": ")[2]
    shape = argparse.RawDescriptionHelpFormatter
    parser = Parser("ia-bench export", USAGE, about, EXAMPLES, formatter_class=shape)
    parser.add_argument("given", nargs="+", metavar="SCENE OUT", help="what is written, and where")
    parser.add_argument("--format", help="the layout that is written, with mesh, truth and lights where it has a place for them")
    parser.add_argument("--for", dest="purpose", choices=["prior"], help="training photographs for a network, instead of a format")
    parser.add_argument("--size", type=int, help="of --for prior: side of the squares that photographs are resized into")
    backgrounds = ["black", "grey", "white", "transparent"]
    parser.add_argument("--background", choices=backgrounds, default="black", help="of --for prior (default: black)")
    parser.add_argument("--crop", action="store_true", help="of --for prior: squares around the object, not the photograph")
    wanted = parser.parse_intermixed_args(arguments)
    settings = [text for text in wanted.given if "=" in text]
    named = [text for text in wanted.given if "=" not in text]
    if not any(text.startswith(("scene=", "scene.path=")) for text in settings) and named:
        name, *named = named
        settings.insert(0, scene_setting(name, settings))
    if len(named) != 1:
        raise InputError(f"ia-bench export: expected SCENE OUT, a scene and a new folder, found {' '.join(wanted.given)}")
    if wanted.size is not None and not 8 <= wanted.size <= 8192:
        raise InputError(f"--size: expected 8 to 8192 pixels, found {wanted.size}")
    out = Path(named[0])
    if out.is_dir() and any(out.iterdir()):
        raise InputError(f"{out}: expected a new folder, or an empty one, found files in it")
    from ia_bench.capture.capture import captured
    from ia_bench.readers.writers.formats import FORMATS, exposed, exposure  # brings in torch, as what follows
    from ia_bench.runs.scene import read_scene, tell

    if (wanted.format is None) == (wanted.purpose is None):
        raise InputError(f"ia-bench export: expected --format NAME ({', '.join(FORMATS)}) or --for prior, found neither or both")
    if wanted.format is not None and wanted.format not in FORMATS:
        raise InputError(unknown("--format", wanted.format, FORMATS))
    if wanted.format is not None and (wanted.size, wanted.background, wanted.crop) != (None, "black", False):
        raise InputError("--size, --background, --crop: expected them with --for prior, which alone heeds them, found --format")
    config = compose(settings)
    expect_outside("OUT", out, config.scene, config.reader)
    scene = read_scene(config.scene, config.reader, truth=True)
    without = scene.mesh is None and config.capture.geometry == "given"  # which a run refuses, and a layout need not
    scene = captured(replace(scene, mesh=NO_MESH) if without else scene, config.capture, lambda line: say(line, sys.stderr))
    scene = replace(scene, mesh=None) if without else scene
    tell(scene, lambda line: say(line, sys.stderr))
    make_writable(out if out.exists() else out.parent, "OUT")
    if wanted.format is not None:
        form = FORMATS[wanted.format]
        factor = 1.0 if form.linear else exposure(scene)
        with whole_folder(out) as place:
            options = form.write(place, exposed(scene, factor))
        options = {key: value.replace(str(place), str(out)) if isinstance(value, str) else value for key, value in options.items()}
        if factor < 1:
            say(
                f"radiance of photographs and lights times {factor:.4g}, so that 8 bits hold 98 % of the object's pixels",
                sys.stdout,
            )
        bounds = sum(int((~view.known & (view.mask > 0)).sum()) for view in scene.train)
        if bounds:
            say(f"{bounds} pixels that are clipped, or not known, are written as they stand, and then pass for known", sys.stdout)
        words = [setting("scene.path", out), *(setting(f"reader.options.{key}", value) for key, value in options.items())]
        say(f"{out}: {scene.name} as {wanted.format}; it is read back by", sys.stdout)
        say(f"  ia-bench check reader={form.reader} {shlex.join(words)}", sys.stdout)
        return OK
    from ia_bench.priors.files import ABOUT, README, write_photographs

    size = f"{wanted.size} x {wanted.size}" if wanted.size else "as large as the photographs"
    more = [*(["--size", str(wanted.size)] if wanted.size else []), *(["--crop"] if wanted.crop else [])]
    text = README.format(
        count=len(scene.train),
        size=size,
        background=wanted.background,
        scene=shlex.join([*settings, *more, "--background", wanted.background]),
        out=shlex.quote(str(out)),
        path=shlex.quote(setting("prior.options.path", out)),
        settings=shlex.join(settings),
        about=ABOUT,
    )
    with whole_folder(out) as place:
        write_photographs(place, scene.train, size=wanted.size, background=wanted.background, crop=wanted.crop)
        (place / "README.txt").write_text(text, encoding="utf-8")
    say(f"{out}: {len(scene.train)} photographs; {out / 'README.txt'} says what to do with them", sys.stdout)
    return OK
