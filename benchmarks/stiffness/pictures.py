"""The spectra of all scenes in one figure, and what each scene's images confuse as pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from benchmarks.stiffness.measure import Measurement
from benchmarks.stiffness.stage import TruthOfAFit
from ia_bench.common.atomic_file import whole_file
from ia_bench.render.renderer import texture_images


def draw_spectra(path: Path, values: Mapping[str, np.ndarray]) -> None:
    """Eigenvalues, over the largest, against the share of directions that are stiffer."""
    figure = Figure(figsize=(6, 3.6), layout="constrained")
    axes = figure.add_subplot()
    for name, spectrum in values.items():
        descending = spectrum[::-1] / spectrum[-1]
        axes.plot(np.linspace(0, 1, len(descending)), descending.clip(1e-12), label=name)
    axes.set(yscale="log", ylim=(1e-10, 1.5), xlabel="share of directions that are stiffer", ylabel="eigenvalue / largest")
    axes.grid(alpha=0.3)
    axes.legend()
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=110)


def draw_confusions(path: Path, stage: TruthOfAFit, measured: Measurement) -> None:
    """A row for each direction: the change of the albedo on the first training view, and that of the log light.

    Grey is no change; the full range of the albedo's picture is its largest change, and the light's likewise. Both are in the
    title, scaled to a largest albedo change of 0.1, with the root mean square change of the images beside them.
    """
    rows = measured.confused
    figure = Figure(figsize=(7.5, 2.6 * len(rows)), layout="constrained")
    for pair, row in zip(figure.subplots(len(rows), 2, squeeze=False, width_ratios=(1, 2)), rows, strict=True):
        albedo, light = (row.change[name] for name in ("albedo", "log_light"))
        picture = texture_images(stage.renderer.surface, stage.gbuffer, torch.from_numpy(albedo).float())[0].numpy()
        for axes, image in zip(pair, (picture, light), strict=True):
            axes.imshow((0.5 + 0.5 * image / max(np.abs(image).max(), 1e-12)).clip(0, 1), interpolation="nearest")
            axes.set_axis_off()
        pair[0].set_title(f"albedo, up to {np.abs(albedo).max():.2g}", fontsize="small")
        title = f"log light, up to {np.abs(light).max():.2g}; together: mu = {row.mu:.2g}, images change by {row.image_change:.1e}"
        pair[1].set_title(title, fontsize="small")
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=90)
