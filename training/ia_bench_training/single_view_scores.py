"""What a prior knows from one image: its samples against the truth, the image taken as albedo, and a constant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.seeds import derive_seed
from ia_bench.methods.contract import Problem
from ia_bench.methods.photographs import stacked, view_geometry
from ia_bench.priors.contract import Observations, Prior
from ia_bench.priors.diffusion.encoding import exposure
from ia_bench.priors.validation import ask
from ia_bench.readers.native import NativeReader
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import Scene, of_one_size
from ia_bench_training.dataset import TrainingImages
from ia_bench_training.validation import psnr_by_name

SAMPLES = 8
HELD_OUT = 64  # images of a folder of shards


@dataclass(frozen=True)
class Examples:
    """Images, as a prior is shown them, and their truth: ``albedo``, ``specular`` (N, H, W, 3), linear, premultiplied."""

    name: str
    shown: Observations
    albedo: Tensor
    specular: Tensor


def load_examples(name: str, limit: int | None = None, *, geometry: bool = False) -> Examples:
    """The test views of a shipped scene or scene folder, or the images of a folder of shards. Raises InputError.

    ``geometry``: normals and visibility too, of a scene by rays against its mesh.
    """
    folder = Path(name)
    if folder.is_dir() and list(folder.glob("shard_*.safetensors")):
        held_out = TrainingImages(folder, limit=limit or HELD_OUT)
        linear = held_out.linear(torch.arange(len(held_out)))
        shown = Observations(linear["image"][..., :3], linear["image"][..., 3])
        if geometry:
            shown = replace(shown, normals=linear["normal"], visibility=linear["visibility"])
        return Examples(folder.name, shown, linear["albedo"], linear["specular"])
    path = resolve_scene_folder(SceneConfig(name=name, path=name if folder.is_dir() else None))
    assert path is not None
    scene = NativeReader(path).read(truth=True)
    views = scene.test[:limit]
    without = [view.name for view in views if view.albedo is None or view.specular is None]
    if without or not views:
        found = f"view {without[0]} without" if without else "no test view"
        raise InputError(f"{path}: expected test views with true albedo and specular shading, found {found}")
    images, masks, albedo, specular = (stacked(of_one_size(views), key) for key in ("image", "mask", "albedo", "specular"))
    shown = Observations(images, masks)
    if geometry:
        normals, visibility = _geometry(replace(scene, train=views).blind())
        shown = replace(shown, normals=normals, visibility=visibility)
    return Examples(name, shown, albedo, specular)


COLUMNS = {
    "albedo_grey": "albedo: one grey",
    "albedo_grey_channels": "one colour",
    "albedo_image": "the image",
    "albedo_image_channels": "the image, channels",
    "albedo_one": "one sample",
    "albedo_one_channels": "one sample, channels",
    "albedo_mean": "mean of samples",
    "albedo_mean_channels": "mean of samples, channels",
    "specular_constant": "specular: best constant",
    "specular_one": "specular: one sample",
    "specular_mean": "specular: mean of samples",
}
"""What the report calls the figures of :class:`ia_bench_training.validation.SingleView`, in its order."""


def score(prior: Prior, examples: Examples, *, samples: int, seed: int) -> dict[str, float]:
    """Mean PSNR by column of the report, of one prior and one seed; what a prior does not provide has no column."""
    images, masks = examples.shown.images, examples.shown.masks
    count = samples if prior.info.stochastic else 1
    answers = [ask(prior, examples.shown, seed=derive_seed(seed, draw)).values for draw in range(count)]
    drawn = {name: torch.stack([answer[name] for answer in answers]) for name in sorted(prior.info.provides)}
    truth = {"albedo": examples.albedo, "specular": examples.specular}
    figures = psnr_by_name(images, masks > 0.5, exposure(images, masks), truth, drawn)
    return {COLUMNS[name]: float(values.nanmean()) for name, values in figures.items()}


def _geometry(scene: Scene) -> tuple[Tensor, Tensor]:
    """Normals and visibility of the training views, as a run gives them to a prior."""
    problem = Problem(scene, RenderSettings(bounces=0), note=lambda _: None)
    return view_geometry(problem, tuple(range(len(scene.train))))
