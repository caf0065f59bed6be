"""All measurements of one scene, from the recorded Jacobians to numbers that a file can hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import torch
from torch import Tensor

from benchmarks.stiffness import spectrum
from benchmarks.stiffness.gauss_newton import Jacobian, gram, stiffest
from benchmarks.stiffness.stage import TruthOfAFit

CHUNK = 1024  # pixels recorded at a time
QUANTILES = (0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99)
STIFFEST = 3  # eigenvalues at the fit's own resolution
ALBEDO_CHANGE = 0.1  # of the directions in pictures


@dataclass(frozen=True)
class Grids:
    """What is measured on: ``pixels`` of the training views, values a side of the textures, rows of the light."""

    pixels: int
    texture: int
    light: int


@dataclass(frozen=True)
class Confusion:
    """A direction that images confuse, scaled so that no albedo changes by more than ALBEDO_CHANGE.

    ``change``: "albedo" (t, t, 3), "roughness" (t, t, 1), "log_light" (h, 2 h, 3), zero where nothing is seen; ``mu`` as in
    :func:`benchmarks.stiffness.spectrum.confusions`; ``image_change``: root mean square, of tone-mapped radiance.
    """

    change: dict[str, np.ndarray]
    mu: float
    image_change: float


@dataclass(frozen=True)
class Measurement:
    """``numbers`` for JSON; the dense spectrum's ``values`` (n,), ascending; directions for pictures."""

    numbers: dict[str, Any]
    values: np.ndarray
    confused: list[Confusion]


def measure(stage: TruthOfAFit, grids: Grids, directions: int) -> Measurement:
    """Measure ``stage``; ``directions``: how many combinations of albedo and light are kept, the most confused ones."""
    pixels = stage.pixels(grids.pixels)
    recorded = [stage.jacobian(part, grids.texture, grids.light, seed=number) for number, part in enumerate(pixels.split(CHUNK))]
    seen = np.any([jacobian.columns_seen().numpy() for jacobian in recorded], axis=0)
    slices, shapes = recorded[0].slices, {name: leaf.shape for name, leaf in recorded[0].parameters.items()}
    rows = sum(jacobian.rows for jacobian in recorded)
    matrix = np.sum([gram(jacobian, seen) for jacobian in recorded], axis=0) / rows
    place = np.cumsum(seen) - 1
    groups = {name: place[part][seen[part]] for name, part in slices.items()}

    values, vectors = scipy.linalg.eigh(matrix)
    scaled = scipy.linalg.eigvalsh(spectrum.jacobi(matrix))
    mu, _ = spectrum.confusions(matrix, groups)
    of_two, mixed = spectrum.confusions(matrix, {name: groups[name] for name in ("albedo", "log_light")})
    tenth = max(1, len(values) // 10)
    radiance = stage.block_radiance(grids.light).numpy().astype(np.float64)
    numbers = {
        "scene": stage.scene.name,
        "pixels": len(pixels),
        "samples": stage.samples,
        "texture": grids.texture,
        "light_rows": grids.light,
        "floored_light_texels": stage.floored,
        "parameters": {name: len(members) for name, members in groups.items()},
        "unseen": {name: int((~seen[part]).sum()) for name, part in slices.items()},
        "largest": float(values[-1]),
        "quantiles": {str(q): float(np.quantile(values, q) / values[-1]) for q in QUANTILES},
        "condition": spectrum.condition(values),
        "condition_jacobi": spectrum.condition(scaled),
        "shares_stiffest_percent": spectrum.shares(vectors[:, -max(1, len(values) // 100) :], groups),
        "shares_flattest_tenth": spectrum.shares(vectors[:, :tenth], groups),
        "median_of_group": {
            name: float(np.median(scipy.linalg.eigvalsh(matrix[np.ix_(own, own)])) / values[-1]) for name, own in groups.items()
        },
        "kept_information": spectrum.kept_information(matrix, groups),
        "confused_below": {str(bound): int((mu < bound).sum()) for bound in (0.001, 0.01, 0.1)},
        "compared": len(mu),
        "albedo_and_light_confused_below": {str(bound): int((of_two < bound).sum()) for bound in (0.001, 0.01, 0.1)},
        "light_parametrisations": _parametrisations(matrix, groups["log_light"], slices["log_light"], seen, radiance),
        **_at_fit_resolution(stage, grids),
    }
    confused = []
    for direction in mixed[:, :directions].T:
        direction = direction * ALBEDO_CHANGE / np.abs(direction[groups["albedo"]]).max()
        whole = np.zeros(len(seen))
        whole[seen] = direction
        change = {group: whole[part].reshape(shapes[group]) for group, part in slices.items()}
        effect = float(np.sqrt(direction @ matrix @ direction))
        confused.append(Confusion(change, spectrum.cancellation(matrix, groups, direction), effect))
    return Measurement(numbers, values, confused)


def _parametrisations(
    matrix: np.ndarray, own: np.ndarray, part: slice, seen: np.ndarray, radiance: np.ndarray
) -> dict[str, dict[str, float]]:
    """Condition with the light's parameters replaced, as they are and with a rate each, without the nulls of redundant ones."""
    found = {}
    for name, transform in spectrum.light_transforms(radiance / radiance.mean(), np.nonzero(seen[part])[0]).items():
        changed = spectrum.reparametrised(matrix, own, transform)
        redundant = transform.shape[1] - transform.shape[0]
        plain, scaled = (scipy.linalg.eigvalsh(m)[redundant:] for m in (changed, spectrum.jacobi(changed)))
        found[name] = {"condition": spectrum.condition(plain), "condition_jacobi": spectrum.condition(scaled)}
    return found


def _at_fit_resolution(stage: TruthOfAFit, grids: Grids) -> dict[str, Any]:
    """The stiffest directions of the fit's own parameters, and its casts, matrix-free."""
    size, rows = stage.material.albedo.shape[0], stage.log_light.shape[0]
    jacobian = stage.jacobian(stage.pixels(min(grids.pixels, CHUNK)), size, rows)
    values, vectors = stiffest(jacobian, STIFFEST)
    groups = {name: np.arange(part.start, part.stop) for name, part in jacobian.slices.items()}
    return {
        "fit_resolution": {
            "parameters": jacobian.columns,
            "unseen": int((~jacobian.columns_seen()).sum()),
            "largest": values.tolist(),
            "shares": [spectrum.shares(vectors[:, k : k + 1], groups) for k in range(STIFFEST)],
        },
        "casts": casts(jacobian, stage.material.albedo),
    }


def casts(jacobian: Jacobian, albedo: Tensor) -> dict[str, dict[str, float]]:
    """Light times c and albedo over c, for every channel and for all three at once; J must be of the fit's own textures (T, T, 3).

    "image_change": root mean square change of the tone-mapped images that a factor of 1.1 makes, to first order, in the channels
    concerned; "light_alone": the same of the light without the albedo; "mu" as in
    :func:`benchmarks.stiffness.spectrum.confusions`.
    """
    found = {}
    for name, channels in (("red", [0]), ("green", [1]), ("blue", [2]), ("all", [0, 1, 2])):
        change = {group: torch.zeros_like(leaf) for group, leaf in jacobian.parameters.items()}
        change["albedo"][..., channels] = -albedo[..., channels]
        change["log_light"][..., channels] = 1
        effect = {}
        for group in ("albedo", "log_light"):
            alone = {other: leaf if other == group else torch.zeros_like(leaf) for other, leaf in change.items()}
            effect[group] = jacobian.forward(torch.cat([leaf.reshape(-1) for leaf in alone.values()])).double()
        power = {group: float(values[:, channels].square().mean()) for group, values in effect.items()}
        both = float((effect["albedo"] + effect["log_light"])[:, channels].square().mean())
        found[name] = {
            "mu": both / sum(power.values()),
            "image_change": float(np.log(1.1) * np.sqrt(both)),
            "light_alone": float(np.log(1.1) * np.sqrt(power["log_light"])),
        }
    return found
