"""The modules of datasets/recipes, which are no package."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "datasets" / "recipes"
NOVEL_LIGHTS = ("studio", "sunset", "night")


def load(name: str) -> ModuleType:
    """A module of the recipes, which are scripts beside each other, not a package."""
    sys.path.insert(0, str(RECIPES))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(RECIPES))


NAMES = ["latlong", "lights", "light_parts", "cameras", "exr", "mesh", "passes", "photographs", "real", "recipe", "scene_folder"]
latlong, lights, light_parts, cameras, exr, mesh, passes, photographs, real, recipe, scene_folder, share_lights, staging = map(
    load, (*NAMES, "share_lights", "staging")
)
