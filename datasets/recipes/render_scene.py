"""Render a scene folder of the benchmark with Blender's Python module.

    python datasets/recipes/render_scene.py hat --size 128 --out datasets/scenes/hat

Files that exist are kept, so a run can be stopped at any time and continued by the same command. Two runs may share a
scene, each with its own range of views (--views-from, --views-to). The run that finds all files present measures the
noise and writes scene.json last.
"""

import argparse
import contextlib
import fcntl
import importlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from atlas import unwrap
from exr import STORED_BITS, round_mantissa, write_exr
from geometry import add_atlas, corners, join_scene, to_blender
from lights import make_light
from materials import bake, textured_material, write_textures
from mesh import check, read_ply, weld, write_ply
from noise import NOISE_DEFINITION, measure
from recipe import RECIPES, Recipe
from renderer import BOUNCES, Passes, Renderer
from scene_folder import View, byte_totals, direct_views, views, write_scene, write_transforms
from split_render import SplitRenderer

ATLAS_SCALE = 2
"""Charts are packed for twice the texture's resolution: closer together, more of the texture used."""


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Send what Blender prints from C to nowhere; Python's own output and all errors still arrive."""
    with os.fdopen(os.dup(1), "w") as console, open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(console):
        os.dup2(nowhere.fileno(), 1)
        try:
            yield
        finally:
            console.flush()
            os.dup2(console.fileno(), 1)


def make_geometry(recipe: Recipe, out: Path) -> None:
    """Model, unwrap and bake the object; write mesh.ply last, as the mark that all of it exists.

    A second process that comes here meanwhile waits for the first; the lock is released even if its owner is killed.
    """
    if (out / "mesh.ply").exists():
        return
    out.mkdir(parents=True, exist_ok=True)
    with (out / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if (out / "mesh.ply").exists():  # made while this process waited
            return
        bpy.ops.wm.read_factory_settings(use_empty=True)
        importlib.import_module(f"objects.{recipe.object}").build()
        item = join_scene()
        found = corners(item.data)
        uv, statistics = unwrap(found.positions, found.vertex, ATLAS_SCALE * recipe.texture_size)
        print(f"atlas: {statistics}", flush=True)
        add_atlas(item.data, found, uv)
        mesh = weld(found.positions[found.vertex], found.normals, uv)
        print(f"mesh: {check(mesh)}", flush=True)
        write_textures(out / "truth", *bake(item, recipe.texture_size))
        write_ply(out / "mesh.ply.part", mesh)
        (out / "mesh.ply.part").rename(out / "mesh.ply")
        (out / ".lock").unlink()


def load(recipe: Recipe, out: Path, *, direct_only: bool, threads: int) -> SplitRenderer:
    """Renderer of exactly what the scene folder holds: mesh.ply, the two textures, the lights."""
    lights = {name: out / "lights" / f"{name}.exr" for name in recipe.lights}
    for name, model in recipe.lights.items():
        if not lights[name].exists():
            write_exr(lights[name], round_mantissa(make_light(model, recipe.light_height), STORED_BITS["light"]))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = to_blender(read_ply(out / "mesh.ply"))
    item.data.materials.append(textured_material(out / "truth"))
    needed = {"train": lights["train"]} if direct_only else lights
    renderer = SplitRenderer(Renderer(recipe.size, direct_only=direct_only, threads=threads), needed, recipe.views["novel"])
    print(f"shares of the samples, the rest and the bright sources: {renderer.shares()}", flush=True)
    return renderer


def write_view(out: Path, view: View, passes: Passes) -> None:
    """Write the image of a view and its ground truth, the image last."""
    for kind, path in view.truth.items():
        write_exr(out / path, round_mantissa(getattr(passes, kind), STORED_BITS[kind]), lossy=kind == "specular")
    write_exr(out / view.image, round_mantissa(passes.rgba, STORED_BITS["image"]), lossy=True)


def render_views(recipe: Recipe, out: Path, renderer: SplitRenderer, wanted: list[View]) -> None:
    """Render the views whose files do not all exist, with one line of progress each."""
    missing = [view for view in wanted if not all((out / path).exists() for path in view.files)]
    print(f"{len(wanted) - len(missing)} views exist, {len(missing)} to render", flush=True)
    start = time.perf_counter()
    for done, view in enumerate(missing, start=1):
        write_view(out, view, renderer.render(view.light, view.pose, recipe.samples[view.split]))
        seconds = (time.perf_counter() - start) / done
        print(f"{view.image}  {done}/{len(missing)}  {seconds:.2f} s a view", flush=True)


def main(arguments: list[str]) -> None:
    """Command line; see the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=RECIPES)
    parser.add_argument("--out", type=Path, required=True, help="scene folder to write")
    parser.add_argument("--size", type=int, help="width and height of the images, pixels (default: the recipe's)")
    parser.add_argument("--views-from", type=int, default=0, help="first view to render, counted over all splits")
    parser.add_argument("--views-to", type=int, help="view to stop before")
    parser.add_argument("--samples", type=int, help="paths a pixel of every view, instead of the recipe's")
    parser.add_argument("--threads", type=int, default=0, help="CPU threads (default: all)")
    parser.add_argument("--direct-only", action="store_true", help="render the direct-light images of some test views")
    options = parser.parse_args(arguments)

    recipe = RECIPES[options.name]
    if options.samples:
        recipe = recipe.with_samples(options.samples)
    if options.size:
        recipe = recipe.at_size(options.size)
    out: Path = options.out
    make_geometry(recipe, out)
    renderer = load(recipe, out, direct_only=options.direct_only, threads=options.threads)
    if options.direct_only:
        for view in direct_views(recipe):
            path = out / "direct" / view.split / f"{view.index:04d}.exr"
            if not path.exists():
                passes = renderer.render("train", view.pose, recipe.samples["direct"])
                write_exr(path, round_mantissa(passes.rgba, STORED_BITS["image"]))
                print(path.relative_to(out), flush=True)
        return

    write_transforms(out, recipe)
    everything = views(recipe)
    render_views(recipe, out, renderer, everything[options.views_from : options.views_to])
    if not all((out / path).exists() for view in everything for path in view.files):
        print("other views are missing: scene.json is written by the run that finds all of them", flush=True)
        return
    for abandoned in out.rglob(".*.exr"):  # half-written by a run that was killed
        abandoned.unlink()
    if not (out / "scene.json").exists():
        write_scene(out, options.name, recipe, describe(recipe, renderer))
    totals = byte_totals(out)
    for kind, count in totals.items():
        print(f"{count:>10,} bytes  {kind}")
    print(f"{sum(totals.values()):>10,} bytes  in all", flush=True)


def describe(recipe: Recipe, renderer: SplitRenderer) -> dict[str, object]:
    """How the images were made, with the measured noise of each light, for scene.json."""
    noise = measure(recipe, renderer)
    for light, value in noise.items():
        print(f"noise under {light}: {value}", flush=True)
    return {
        "renderer": f"Blender {bpy.app.version_string} Cycles, CPU",
        "size": recipe.size,
        "samples": recipe.samples,
        "sample_shares": renderer.shares(),
        "bounces": BOUNCES,
        "pixel_filter": "box, 1 pixel",
        "noise": noise,
        "noise_definition": NOISE_DEFINITION,
        "numpy": np.__version__,
    }


if __name__ == "__main__":
    with quiet():
        main(sys.argv[1:])
