"""``ia-bench score WHAT --scene NAME``: scores of what other software recovered, as a row beside those of this package."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ia_bench.cli import run
from ia_bench.common.errors import InputError, unknown
from ia_bench.common.exit_codes import OK, command, say
from ia_bench.common.files import is_file, shown

USAGE = """\
ia-bench score WHAT --scene NAME|FOLDER [--OPTION VALUE ...] [SETTING=VALUE ...]

Scores what other software recovered of a scene, and leaves a run folder that every report takes. WHAT is
  a mesh with textures    .glb, .gltf, or .obj with its .mtl
  a folder of pictures    albedo/, roughness/, view_synthesis/ and relighting/LIGHT/, one picture a held-out view,
                          called like the view: OpenEXR (linear, premultiplied) or PNG (straight alpha)

  ia-bench score mesh.obj --light probe.hdr --light-turn 90 --scene hat       nvdiffrec's files
  ia-bench score asset.glb --scene hat                                        without a light, which leaves out one score
  ia-bench score predictions --encoding srgb --scene hat                      pictures, PNG in sRGB
  ia-bench score runs/hat/none-1234abcd --pictures OUT                        writes a run's pictures in that layout

Options
  --scene NAME|FOLDER     the scene; for another format than ours also reader=NAME
  --light FILE            the light that belongs to the mesh, lat-long, .exr or .hdr; row 0 is up, the middle column +x
  --light-turn DEGREES    turns it about the vertical, counter-clockwise from above
  --up y|z                the axis of the mesh that points up (y, as glTF has it)
  --matrix ROWS           [[a,b,c,d],[e,f,g,h],[i,j,k,l],[0,0,0,1]], which moves it to the scene's place after that
  --align icp             moves and scales it to the nearest points of the scene's mesh
  --texture-size N        reduces larger textures
  --encoding srgb|linear  of PNG pictures of colour;  --albedo-encoding of albedo alone
  --order sorted|FILE     pictures by name in the order of the views, or called as the frames of a transforms file say
  --authors, --code, --hardware TEXT, --seconds N      what you declare of it; tables mark it as declared
  --row NAME              its name in tables;  --out FOLDER  its folder, otherwise runs/<scene>/<row>-<hash>
SETTING=VALUE is any setting of a run, such as protocol=stanford-orb or capture.geometry=hull.
"""
MESHES = (".glb", ".gltf", ".obj")
OPTIONS = {
    "light": "light",
    "light-turn": "light_turn",
    "up": "up",
    "matrix": "matrix",
    "align": "align",
    "texture-size": "texture_size",
    "encoding": "encoding",
    "albedo-encoding": "albedo_encoding",
    "order": "order",
    "authors": "declared.authors",
    "code": "declared.code",
    "hardware": "declared.hardware",
    "seconds": "declared.seconds",
}
"""Option of this command -> that of the method."""
TEXTS = ("light", "order", "authors", "code", "hardware")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    return command(lambda: USAGE, _work, arguments)


def _work(arguments: list[str]) -> int:
    what, options, settings = _parsed(arguments)
    path = Path(what).expanduser()
    if "pictures" in options:
        return _write_pictures(path, options)
    if "scene" not in options:
        raise InputError("--scene: expected the scene that it was recovered of, found none")
    if path.is_dir() and is_file(path / "metrics.json"):
        raise InputError(f"{shown(path)}: expected results of other software, found a run; --pictures OUT writes its pictures")
    if not (path.is_dir() or path.suffix.lower() in MESHES):
        raise InputError(f"{shown(what)}: expected a mesh ({', '.join(MESHES)}) or a folder of pictures, found neither")
    return run.main([*overrides(path, options), *settings])


def overrides(path: Path, options: dict[str, str]) -> list[str]:
    """The settings of a run that scores what lies at ``path``, from the options of the command line."""
    scene = options["scene"]
    is_folder = "/" in scene or scene.startswith(".")
    found = [f"method={'images' if path.is_dir() else 'asset'}", f"{'scene.path' if is_folder else 'scene'}={_quoted(scene)}"]
    found.append(f"method.options.path={_quoted(str(path))}")
    for option, key in OPTIONS.items():
        if option in options:
            value = options[option]
            found.append(f"method.options.{key}={_quoted(value) if option in TEXTS else value}")
    return found + [f"{name}={_quoted(options[name])}" for name in ("row", "out") if name in options]


def _parsed(arguments: list[str]) -> tuple[str, dict[str, str], list[str]]:
    """What is scored, the options, and the settings. Raises InputError naming an argument that is none of them."""
    known = {*OPTIONS, "scene", "row", "out", "pictures"}
    what, options, settings, rest = "", dict[str, str](), list[str](), list(arguments)
    while rest:
        text = rest.pop(0)
        if text.startswith("--"):
            name, has_value, value = text[2:].partition("=")
            if name not in known:
                raise InputError(unknown("option", name, sorted(known), prefix="--"))
            if not has_value and not rest:
                raise InputError(f"--{name}: expected a value, found none")
            options[name] = value if has_value else rest.pop(0)
        elif "=" in text:
            settings.append(text)
        elif what:
            raise InputError(f"{shown(text)}: expected one mesh or folder, found a second one beside {shown(what)}")
        else:
            what = text
    if not what:
        raise InputError("expected a mesh (.glb, .gltf, .obj) or a folder of pictures, found nothing; --help says more")
    return what, options, settings


def _quoted(text: str) -> str:
    """A text as Hydra takes it, whatever is in it."""
    return json.dumps(text, ensure_ascii=False)


def _write_pictures(folder: Path, options: dict[str, str]) -> int:
    others = ", ".join(f"--{name}" for name in options if name != "pictures")
    if others:
        raise InputError(f"--pictures: expected no other option with it, found {others}")
    from ia_bench.runs.predictions import write_predictions  # brings in the renderer

    written = write_predictions(folder, Path(options["pictures"]))
    say("\n".join(f"{options['pictures']}/{name}: {count} pictures" for name, count in written.items()), sys.stdout)
    return OK


if __name__ == "__main__":
    raise SystemExit(main())
