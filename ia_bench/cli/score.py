"""``ia-bench score WHAT --scene NAME``: scores of what other software recovered, as a row beside those of this package."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.cli.run import run
from ia_bench.common.arguments import Parser
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, exits, say
from ia_bench.common.files import is_file, shown
from ia_bench.runs.composition import compose, scene_setting, written

USAGE = "ia-bench score WHAT --scene NAME|FOLDER [--OPTION VALUE ...] [SETTING=VALUE ...]"
ABOUT = """\
Scores what other software recovered of a scene, and leaves a run folder that every report takes. WHAT is
  a mesh with textures    .glb, .gltf, or .obj with its .mtl
  a folder of pictures    albedo/, roughness/, view_synthesis/ and relighting/LIGHT/, one picture a held-out view,
                          called like the view: OpenEXR (linear, premultiplied) or PNG (straight alpha)
SETTING=VALUE is any setting of a run, such as protocol=stanford-orb, capture.geometry=hull or reader=nerfstudio.

  ia-bench score mesh.obj --light probe.hdr --light-turn 90 --scene hat       nvdiffrec's files
  ia-bench score predictions --encoding srgb --scene hat                      pictures, PNG in sRGB
  ia-bench score runs/hat/none-1234abcd --pictures OUT                        writes a run's pictures in that layout
"""
MESHES = (".glb", ".gltf", ".obj")
OPTIONS = {
    "light": "the light that belongs to the mesh, lat-long, .exr or .hdr; row 0 is up, the middle column +x",
    "light_turn": "degrees by which it is turned about the vertical, counter-clockwise from above",
    "up": "y or z: the axis of the mesh that points up (y, as glTF has it)",
    "matrix": "[[a,b,c,d],[e,f,g,h],[i,j,k,l],[0,0,0,1]], which moves it to the scene's place after that",
    "align": "icp moves and scales it to the nearest points of the scene's mesh",
    "texture_size": "reduces larger textures",
    "encoding": "srgb or linear: that of PNG pictures of colour",
    "albedo_encoding": "that of albedo alone",
    "order": "sorted: pictures by name in the order of the views; FILE: called as the frames of a transforms file say",
}
"""Option of the method -> what it is."""
DECLARED = ("authors", "code", "hardware", "seconds")
TEXTS = ("light", "order", *DECLARED[:3])


@exits(resumes=True)
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = Parser("ia-bench score", USAGE, ABOUT, formatter_class=kind)
    parser.add_argument("given", nargs="+", metavar="WHAT", help="a mesh or a folder, and settings")
    parser.add_argument("--scene", metavar="NAME|FOLDER", help="what it was recovered of")
    parser.add_argument("--pictures", metavar="OUT", help="write the pictures of a run into a folder instead")
    for name, about in OPTIONS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", metavar="X", help=about)
    for name in DECLARED:
        parser.add_argument(f"--{name}", metavar="X", help="what you declare of it; tables mark it as declared")
    parser.add_argument("--row", help="its name in tables")
    parser.add_argument("--out", metavar="FOLDER", help="its folder (default: runs/SCENE/ROW-HASH)")
    wanted = parser.parse_intermixed_args(arguments)
    what, *others = [text for text in wanted.given if "=" not in text] or [""]
    if not what or others:
        raise InputError(f"expected one mesh ({', '.join(MESHES)}) or folder of pictures, found {shown(' '.join(wanted.given))}")
    path = Path(what).expanduser()
    if wanted.pictures is not None:
        named = [name for name, value in vars(wanted).items() if value is not None and name not in ("given", "pictures")]
        others = [*(f"--{name.replace('_', '-')}" for name in named), *(text for text in wanted.given if "=" in text)]
        if others:
            raise InputError(f"--pictures: expected nothing but a run and OUT, found {', '.join(others)}")
        from ia_bench.runs.submissions import write_predictions  # brings in the renderer

        for name, count in write_predictions(path, Path(wanted.pictures)).items():
            say(f"{wanted.pictures}/{name}: {count} pictures", sys.stdout)
        return OK
    if wanted.scene is None:
        raise InputError("--scene: expected the scene that it was recovered of, found none")
    if path.is_dir() and is_file(path / "metrics.json"):
        raise InputError(f"{shown(path)}: expected results of other software, found a run; --pictures OUT writes its pictures")
    if not (path.is_dir() or path.suffix.lower() in MESHES):
        raise InputError(f"{shown(what)}: expected a mesh ({', '.join(MESHES)}) or a folder of pictures, found neither")
    settings = [text for text in wanted.given if "=" in text]
    found = {"method": "images" if path.is_dir() else "asset", "method.options.path": written(what)}
    keys = {name: f"method.options.{name}" for name in OPTIONS} | {name: f"method.options.declared.{name}" for name in DECLARED}
    for name, key in {**keys, "row": "row", "out": "out"}.items():
        if (value := getattr(wanted, name)) is not None:
            found[key] = written(value) if name in (*TEXTS, "row", "out") else value
    try:
        return run(compose([scene_setting(wanted.scene, settings), *(f"{key}={value}" for key, value in found.items()), *settings]))
    except InputError as error:  # of what was asked for, in the words in which it was
        raise InputError(re.sub(r"method\.options\.(declared\.)?(\w+)", _as_typed, str(error))) from error


def _as_typed(key: re.Match[str]) -> str:
    """An option of the method as it is called on this command line; one that has no name here as it is."""
    name = key.group(2)
    return f"--{name.replace('_', '-')}" if name in (*OPTIONS, *DECLARED) else "WHAT" if name == "path" else key.group()
