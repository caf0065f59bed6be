"""Albedo and specular shading behind single images, by a prior alone.

Use it as::

    from ia_bench import decompose
    parts = decompose("photo.jpg")
    parts.mean["albedo"], parts.spread["albedo"]  # (H, W, 3) linear, premultiplied by parts.mask
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from ia_bench.common import registry
from ia_bench.common.atomic_file import whole_file
from ia_bench.common.calls import expect_kind, expect_whole, path_of
from ia_bench.common.errors import InputError
from ia_bench.common.exit_codes import log
from ia_bench.common.progress import Begin, unseen
from ia_bench.common.seeds import derive_seed
from ia_bench.priors.contract import Observations, Prior
from ia_bench.priors.validation import ask, beyond_a_material, check_prior_info, name_of
from ia_bench.runs.composition import compose
from ia_bench.runs.pictures.preview import labelled
from ia_bench.scenes.exr import write_exr
from ia_bench.scenes.images import display
from ia_bench.scenes.photograph import read_photograph

SPREAD_GAIN = 4.0
"""The spread is shown this much brighter; it is a standard deviation of linear values and mostly small."""
EXPOSED_QUANTILE = 0.99
"""This share of an HDR image's pixels fits below white on the sheet."""
SHEET = 200  # pixels of width for each picture of a sheet


@dataclass(frozen=True)
class Decomposition:
    """What the prior makes of one image. All (H, W, 3) float32, linear, premultiplied by ``mask`` (H, W) in [0, 1].

    ``image``: what it was given, possibly reduced; ``mean`` and ``spread`` (standard deviation) over ``samples`` samples, by
    component ("albedo" in [0, 1], "specular" in the radiance of the image). ``network_calls``: evaluations it took.
    """

    image: np.ndarray = field(repr=False)
    mask: np.ndarray = field(repr=False)
    mean: dict[str, np.ndarray] = field(repr=False)
    spread: dict[str, np.ndarray] = field(repr=False)
    samples: int
    network_calls: int


def decompose(
    image: str | Path,
    mask: str | Path | None = None,
    *,
    prior: str = "regressor",
    options: Mapping[str, Any] | None = None,
    samples: int = 8,
    size: int = 512,
    seed: int = 0,
) -> Decomposition:
    """Split a picture into albedo and specular shading.

    ``image``, ``mask``: files, see :func:`ia_bench.scenes.photograph.read_photograph`. ``prior``: a name or "module:Class", with
    ``options``; the regressor is nearest to the truth, samples of "diffusion" have a spread. ``samples``: at least 1.
    ``size``: a picture whose longer side has more pixels is reduced to that many, at least 8. ``seed``: at least 0.
    Raises InputError.
    """
    expect_whole(1, samples=samples)
    expect_whole(8, size=size)
    expect_whole(0, seed=seed)
    expect_kind(str, "a prior's name", prior=prior)
    expect_kind(Mapping | None, "a table", options=options)
    maker = make_prior(prior, options or {})
    radiance, coverage = read_photograph(path_of("image", image), None if mask is None else path_of("mask", mask))
    return decompose_with(maker, *reduced(radiance, coverage, size), samples=samples, seed=seed)


def write_decomposition(parts: Decomposition, folder: Path, name: str) -> list[Path]:
    """Write every component, and any spread, as PNG (sRGB, straight alpha) and EXR (linear, premultiplied), and a sheet of all.

    Only the PNG of a spread is brightened, by SPREAD_GAIN.
    """
    exposure = float(min(1.0, 1 / max(np.quantile(parts.image.max(-1), EXPOSED_QUANTILE), 1e-12)))  # of what would clip
    pictures = {"image": _shown(parts.image, parts.mask, exposure)}
    written = []
    for component, mean in parts.mean.items():
        gain = 1.0 if component == "albedo" else exposure
        kinds = [(component, mean, gain), (f"{component}_spread", parts.spread[component], SPREAD_GAIN * gain)]
        for part, values, brightness in kinds if parts.samples > 1 else kinds[:1]:
            pictures[part] = _shown(values, parts.mask, brightness)
            write_exr(folder / f"{name}_{part}.exr", np.dstack([values, parts.mask]), half=False)
            written += [folder / f"{name}_{part}.exr", _save(pictures[part], folder / f"{name}_{part}.png")]
    captions = {part: part.replace("_spread", f" {SPREAD_GAIN:g} x spread") for part in pictures}
    sheet = labelled([[(captions[part], picture) for part, picture in pictures.items()]], width=len(pictures) * SHEET)
    return [*written, _save(sheet, folder / f"{name}_sheet.png")]


def make_prior(name: str, options: Mapping[str, Any], overrides: Sequence[str] = ()) -> Prior:
    """The prior called ``name``, with ``options`` over what ``overrides`` set. Raises InputError for one of no use here."""
    config = compose([f"prior={name}", *overrides]).prior
    given = {key: str(value) if isinstance(value, Path) else value for key, value in options.items()}
    prior: Prior = registry.create("prior", config.name, config.target, {**config.options, **given})
    check_prior_info(prior)
    if prior.info.sees_truth:
        raise InputError(f"prior: {name} needs ground truth, which a photograph does not have")
    if not prior.info.provides:
        raise InputError(f"prior: {name} provides nothing to decompose an image into")
    return prior


def decompose_with(
    prior: Prior,
    image: np.ndarray,
    mask: np.ndarray,
    *,
    samples: int,
    seed: int,
    begin: Begin = unseen,
) -> Decomposition:
    """Split an image (H, W, 3), linear and premultiplied by its mask (H, W), with a prior that is made already.

    ``begin`` shows how many samples are drawn.
    """
    shown = Observations(torch.from_numpy(image)[None], torch.from_numpy(mask)[None])
    count = samples if prior.info.stochastic else 1
    task, drawn = begin("samples", count), []
    for draw in range(count):
        drawn.append(ask(prior, shown, seed=derive_seed(seed, draw)))
        task.advance()
    if (wrong := beyond_a_material(drawn[0], shown.masks)) is not None:
        log.warning("prior %s proposes %s; it is used, and ia-bench check says more", name_of(prior), wrong)
    stacked = {name: torch.stack([one.values[name][0] for one in drawn]).numpy() for name in sorted(prior.info.provides)}
    return Decomposition(
        image=image,
        mask=mask,
        mean={name: values.mean(0) for name, values in stacked.items()},
        spread={name: values.std(0) for name, values in stacked.items()},
        samples=count,
        network_calls=sum(one.cost.get("network_calls", 0) for one in drawn),
    )


def reduced(radiance: np.ndarray, coverage: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The image with at most ``size`` pixels along its longer side, averaged in linear light."""
    height, width = coverage.shape
    scale = size / max(height, width)
    if scale >= 1:
        return radiance, coverage
    shape = max(round(width * scale), 1), max(round(height * scale), 1)
    planes = np.moveaxis(np.dstack([radiance, coverage]), -1, 0)
    stacked = np.stack([np.asarray(Image.fromarray(one).resize(shape, Image.Resampling.BOX)) for one in planes], -1).clip(0)
    return np.ascontiguousarray(stacked[..., :3]), stacked[..., 3].clip(0, 1)


def _save(picture: Image.Image, path: Path) -> Path:
    with whole_file(path) as partial:
        picture.save(partial)
    return path


def _shown(linear: np.ndarray, mask: np.ndarray, exposure: float) -> Image.Image:
    """A picture in sRGB with straight alpha, of premultiplied linear values."""
    return Image.fromarray(np.round(255 * np.dstack([display(linear, mask, exposure), mask])).astype(np.uint8))
