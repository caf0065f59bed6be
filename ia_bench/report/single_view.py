"""What a prior knows from one image: its samples against the truth, the image taken as albedo, and a constant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.common.seeds import derive_seed
from ia_bench.methods.asking.border import ask
from ia_bench.methods.asking.geometry import view_geometry
from ia_bench.methods.contract import Problem
from ia_bench.priors.contract import Observations, Prior
from ia_bench.priors.diffusion.encoding import exposure
from ia_bench.readers.native import NativeReader
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.scenes.scene import Scene
from ia_bench.training.dataset import TrainingImages
from ia_bench.training.validation import aligned_psnr, psnr

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
    for view in views:
        if view.albedo is None or view.specular is None:
            raise InputError(f"{path}: test view {view.name}: expected true albedo and specular shading, found none")
    images, masks, albedo, specular = (
        torch.stack([torch.from_numpy(getattr(view, key)) for view in views]) for key in ("image", "mask", "albedo", "specular")
    )
    shown = Observations(images, masks)
    if geometry:
        normals, visibility = _geometry(replace(scene, train=views).blind())
        shown = replace(shown, normals=normals, visibility=visibility)
    return Examples(name, shown, albedo, specular)


def score(prior: Prior, examples: Examples, *, samples: int, seed: int) -> dict[str, float]:
    """Mean PSNR by column of the report, of one prior and one seed."""
    images, masks = examples.shown.images, examples.shown.masks
    inside = masks > 0.5
    count = samples if prior.info.stochastic else 1
    drawn = [ask(prior, examples.shown, seed=derive_seed(seed, draw)).values for draw in range(count)]
    figures: dict[str, Tensor] = {}
    if "albedo" in prior.info.provides:
        means = torch.stack([sample["albedo"] for sample in drawn]).mean(0)
        for name, value in (("image", images), ("one sample", drawn[0]["albedo"]), (f"mean of {count}", means)):
            for kind, channels in (("", False), (", channels", True)):
                figures[f"albedo: {name}{kind}"] = aligned_psnr(value, examples.albedo, inside, channels=channels)
    if "specular" in prior.info.provides:
        factor = exposure(images, masks)[:, None, None, None]
        truth = (examples.specular * factor).clamp(0, 1)
        weight = inside[..., None].float()
        constant = (truth * weight).sum((1, 2), keepdim=True) / weight.sum((1, 2), keepdim=True).clamp_min(1)
        means = torch.stack([sample["specular"] for sample in drawn]).mean(0)
        figures["specular: constant"] = psnr(constant.expand_as(truth), truth, inside)
        figures["specular: one sample"] = psnr((drawn[0]["specular"] * factor).clamp(0, 1), truth, inside)
        figures[f"specular: mean of {count}"] = psnr((means * factor).clamp(0, 1), truth, inside)
    return {name: float(values.mean()) for name, values in figures.items()}


def _geometry(scene: Scene) -> tuple[Tensor, Tensor]:
    """Normals and visibility of the training views, as a run gives them to a prior."""
    problem = Problem(scene, RenderSettings(bounces=0, shading="eager"), note=lambda _: None)
    return view_geometry(problem, tuple(range(len(scene.train))))
