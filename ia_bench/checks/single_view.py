"""What a prior knows from one image: its samples against the truth, the image taken as albedo, and a constant.

    python -m ia_bench.checks.single_view hat ship console figurine --prior diffusion --seeds 0 1 2

One Markdown row per scene (its test views) or folder of held-out training images. PSNR in dB of linear values inside the
mask, per image, then averaged. Albedo is scaled by one factor per image that makes its mean the truth's ("..., channels":
one per channel, which forgives a colour cast). Specular shading is not scaled, but shown at the exposure at which the
image nearly fills a display, and clipped there; the constant is the best colour for each image, so it has seen the truth.
± is half the range that holds the mean over seeds with 95 % confidence (Student's t).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ia_bench.checks.problem import make_problem
from ia_bench.common.arguments import at_least
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import OK, complain
from ia_bench.common.seeds import derive_seed
from ia_bench.methods.asking.geometry import view_geometry
from ia_bench.priors.contract import GeometryReader
from ia_bench.priors.diffusion.encoding import exposure
from ia_bench.priors.none import NoPrior
from ia_bench.readers.native import load_scene
from ia_bench.report.statistics import over_seeds
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.runs.decomposition import make_prior
from ia_bench.training.dataset import TrainingImages
from ia_bench.training.validation import aligned_psnr, psnr

SAMPLES = 8
HELD_OUT = 64  # images of a folder of shards


@dataclass(frozen=True)
class Examples:
    """Images with truth: ``images``, ``albedo``, ``specular`` (N, H, W, 3) linear, premultiplied by ``masks`` (N, H, W).

    ``geometry``: normals and visibility, as :class:`ia_bench.priors.contract.GeometryReader` takes them, where asked for.
    """

    name: str
    images: Tensor
    masks: Tensor
    albedo: Tensor
    specular: Tensor
    geometry: tuple[Tensor, Tensor] | None = None


def load_examples(name: str, limit: int | None = None, *, geometry: bool = False) -> Examples:
    """The test views of a shipped scene or scene folder, or the images of a folder of shards. Raises InputError.

    ``geometry``: normals and visibility too, of a scene by rays against its mesh.
    """
    folder = Path(name)
    if folder.is_dir() and list(folder.glob("shard_*.safetensors")):
        held_out = TrainingImages(folder, limit=limit or HELD_OUT)
        linear = held_out.linear(torch.arange(len(held_out)))
        radiance, masks = linear["image"][..., :3], linear["image"][..., 3]
        seen = (linear["normal"], linear["visibility"]) if geometry else None
        return Examples(folder.name, radiance, masks, linear["albedo"], linear["specular"], seen)
    path = resolve_scene_folder(SceneConfig(name=name, path=name if folder.is_dir() else None))
    assert path is not None
    scene = load_scene(path, truth=True)
    views = scene.test[:limit]
    for view in views:
        if view.albedo is None or view.specular is None:
            raise InputError(f"{path}: test view {view.name}: expected true albedo and specular shading, found none")
    images, masks, albedo, specular = (
        torch.stack([torch.from_numpy(getattr(view, key)) for view in views]) for key in ("image", "mask", "albedo", "specular")
    )
    seen = None
    if geometry:
        problem, _ = make_problem(replace(scene, train=views), NoPrior())
        seen = view_geometry(problem, tuple(range(len(views))))
    return Examples(name, images, masks, albedo, specular, seen)


def score(prior: Any, examples: Examples, *, samples: int, seed: int) -> dict[str, float]:  # noqa: ANN401 (any prior)
    """Mean PSNR by column of the report, of one prior and one seed."""
    inside = examples.masks > 0.5
    count = samples if prior.stochastic else 1
    if examples.geometry is not None:
        prior.give_geometry(*examples.geometry)
    drawn = [prior.sample(examples.images, examples.masks, seed=derive_seed(seed, draw)) for draw in range(count)]
    figures: dict[str, Tensor] = {}
    if "albedo" in prior.provides:
        means = torch.stack([sample["albedo"] for sample in drawn]).mean(0)
        for name, value in (("image", examples.images), ("one sample", drawn[0]["albedo"]), (f"mean of {count}", means)):
            for kind, channels in (("", False), (", channels", True)):
                figures[f"albedo: {name}{kind}"] = aligned_psnr(value, examples.albedo, inside, channels=channels)
    if "specular" in prior.provides:
        factor = exposure(examples.images, examples.masks)[:, None, None, None]
        truth = (examples.specular * factor).clamp(0, 1)
        weight = inside[..., None].float()
        constant = (truth * weight).sum((1, 2), keepdim=True) / weight.sum((1, 2), keepdim=True).clamp_min(1)
        means = torch.stack([sample["specular"] for sample in drawn]).mean(0)
        figures["specular: constant"] = psnr(constant.expand_as(truth), truth, inside)
        figures["specular: one sample"] = psnr((drawn[0]["specular"] * factor).clamp(0, 1), truth, inside)
        figures[f"specular: mean of {count}"] = psnr((means * factor).clamp(0, 1), truth, inside)
    return {name: float(values.mean()) for name, values in figures.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and return the exit status."""
    about, _, more = (__doc__ or "").partition("\n")
    style = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m ia_bench.checks.single_view", description=about, epilog=more, formatter_class=style, allow_abbrev=False
    )
    parser.add_argument("examples", nargs="+", help="shipped scenes, scene folders, or folders of held-out shards")
    parser.add_argument("--prior", default="diffusion", help="a prior's name or module:Class (default: diffusion)")
    parser.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="an option of the prior")
    parser.add_argument("--samples", type=at_least(1), default=SAMPLES, help=f"samples whose mean is scored (default: {SAMPLES})")
    parser.add_argument("--seeds", type=at_least(0), nargs="+", default=[0], help="seeds (default: 0)")
    parser.add_argument("--limit", type=at_least(1), help="at most this many images of each")
    wanted = parser.parse_args(arguments)
    try:
        prior = make_prior(wanted.prior, wanted.option)
        geometry = isinstance(prior, GeometryReader) and prior.reads_geometry
        loaded = [load_examples(name, wanted.limit, geometry=geometry) for name in wanted.examples]
        header: list[str] | None = None
        for examples in loaded:
            runs = [score(prior, examples, samples=wanted.samples, seed=seed) for seed in wanted.seeds]
            if header is None:
                header = list(runs[0])
                print("| " + " | ".join(["images", *header]) + " |\n|" + " :--- |" * (len(header) + 1))
            cells = [_cell([run[name] for run in runs]) for name in header]
            print("| " + " | ".join([f"{examples.name} ({len(examples.images)})", *cells]) + " |", flush=True)
    except InputError as error:
        return complain(str(error))
    return OK


def _cell(values: list[float]) -> str:
    estimate = over_seeds(values)
    assert estimate is not None
    return f"{estimate.mean:.2f}" + ("" if estimate.half_width is None else f" ± {estimate.half_width:.2f}")


if __name__ == "__main__":
    sys.exit(main())
