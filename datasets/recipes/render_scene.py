"""Render a scene folder of the benchmark with Blender's Python module.

    python datasets/recipes/render_scene.py hat --out results/datasets/scenes/hat

The scene is rendered in a hidden folder beside its place (.hat.rendering) and moved there when it is complete, in place
of what was there. Files of an unfinished render are kept, so a run can be stopped at any time and continued by the same
command. Several runs may share a scene, each with its own range of views (--views-from, --views-to). The run that finds
all files present measures the noise, writes scene.json and moves the folder.
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
import scanned
from atlas import unwrap
from exr import store
from geometry import add_atlas, corners, join_scene, to_blender
from lights import make_light
from materials import bake, textured_material, write_textures
from mesh import check, read_ply, weld, write_ply
from noise import NOISE_DEFINITION, measure
from passes import Passes
from real import real_file
from recipe import RECIPES, Recipe
from renderer import BOUNCES, Renderer
from scene_folder import View, byte_totals, views, write_scene, write_transforms
from split_render import SplitRenderer
from staging import begin, publish

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
        if recipe.scanned:
            scanned.build(real_file(recipe.object))
        else:
            importlib.import_module(f"objects.{recipe.object}").build()
        item = join_scene()
        found = corners(item.data)
        uv, statistics = unwrap(found.positions, found.vertex, ATLAS_SCALE * recipe.texture_size)
        print(f"atlas: {statistics}", flush=True)
        add_atlas(item.data, found, uv)
        mesh = weld(found.positions[found.vertex], found.normals, uv)
        print(f"mesh: {check(mesh)}", flush=True)
        textures = bake(item, recipe.texture_size)
        write_textures(
            out / "truth", scanned.within_range(textures, metal=recipe.metal) if recipe.scanned else textures, metal=recipe.metal
        )
        write_ply(out / "mesh.ply.part", mesh)
        (out / "mesh.ply.part").rename(out / "mesh.ply")


def make_lights(recipe: Recipe, out: Path) -> dict[str, Path]:
    """Write the lights that are not there yet; the file of every light by its name.

    Raises:
        ValueError: if a photographed light cannot be had; the message says what to do.
    """
    lights = {name: out / "lights" / f"{name}.exr" for name in recipe.lights}
    for name, model in recipe.lights.items():
        if not lights[name].exists():
            store(lights[name], make_light(model, recipe.light_height), "light")
    return lights


def load(recipe: Recipe, out: Path, lights: dict[str, Path], threads: int) -> SplitRenderer:
    """Renderer of exactly what the scene folder holds: mesh.ply, its textures, the lights."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = to_blender(read_ply(out / "mesh.ply"))
    item.data.materials.append(textured_material(out / "truth"))
    renderer = SplitRenderer(Renderer(recipe.size, threads), lights, recipe.views["novel"], recipe.least_power)
    print(f"shares of the samples, the rest and the bright sources: {renderer.shares()}", flush=True)
    return renderer


def write_view(out: Path, view: View, passes: Passes) -> None:
    """Write the image of a view and its ground truth, the image last."""
    for kind, path in view.truth.items():
        coarse = kind == "specular" and view.split == "train"
        store(out / path, getattr(passes, kind), "train_specular" if coarse else kind)
    store(out / view.image, passes.rgba, "image")


def render_views(recipe: Recipe, out: Path, renderer: SplitRenderer, wanted: list[View]) -> None:
    """Render the views whose files do not all exist, with one line of progress each."""
    missing = [view for view in wanted if not all((out / path).exists() for path in view.files)]
    print(f"{len(wanted) - len(missing)} views exist, {len(missing)} to render", flush=True)
    start = time.perf_counter()
    for done, view in enumerate(missing, start=1):
        samples = recipe.samples[view.split]
        write_view(out, view, renderer.render(view.light, view.pose, samples, direct_only=view.split == "direct"))
        seconds = (time.perf_counter() - start) / done
        print(f"{view.image}  {done}/{len(missing)}  {seconds:.2f} s a view", flush=True)


def main(arguments: list[str]) -> None:
    """Command line; see the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=RECIPES)
    parser.add_argument("--out", type=Path, required=True, help="scene folder to write")
    parser.add_argument("--size", type=int, help="width and height of the images, pixels (default: the recipe's)")
    parser.add_argument("--samples", type=int, help="paths a pixel of every view (default: the recipe's)")
    parser.add_argument("--views-from", type=int, default=0, help="first view to render, counted over all splits")
    parser.add_argument("--views-to", type=int, help="view to stop before")
    parser.add_argument("--threads", type=int, default=0, help="CPU threads (default: all)")
    options = parser.parse_args(arguments)

    recipe = RECIPES[options.name]
    if options.samples:
        recipe = recipe.with_samples(options.samples)
    if options.size:
        recipe = recipe.at_size(options.size)
    try:
        folder = begin(options.out, recipe)
        lights = make_lights(recipe, folder)
        make_geometry(recipe, folder)
    except ValueError as error:
        parser.error(str(error))
    renderer = load(recipe, folder, lights, options.threads)
    write_transforms(folder, recipe)
    everything = views(recipe)
    render_views(recipe, folder, renderer, everything[options.views_from : options.views_to])
    if not all((folder / path).exists() for view in everything for path in view.files):
        print("other views are missing: the run that finds all of them finishes the scene", flush=True)
        return
    write_scene(folder, options.name, recipe, describe(recipe, renderer))
    publish(folder, options.out)
    totals = byte_totals(options.out)
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
        "lights": recipe.lights,
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
