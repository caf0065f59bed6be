"""The inverse half of the work-precision diagrams: whole fits of the scene ``tiny``, error against seconds.

Every fit is a run of ``ia-bench run`` with other settings, so what is compared is what a user gets, but for indirect
light and the layered coat, which the other side has not. The learning rates fall over a fit's own steps, so every point is a
fit of its own, not a moment of a longer one. All ways of dividing a budget draw the same number of samples in all: steps x
fit.pixels x render.samples. Mitsuba's plain loop (the method ``mitsuba_adam``) draws as many on the object. Of the oracle it
gets the albedo, ours the specular shading as well.

``seconds`` is the wall time of the optimisation as curve.csv has it, without the compiler's. ``cpu_s`` is that times the
share of the run's wall time in which the processor worked for it: 1 on a quiet machine, with one thread.
"""

from __future__ import annotations

import csv
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.work_precision.precision import without_compilation
from ia_bench.common.errors import InputError
from ia_bench.readers.native import NativeReader
from ia_bench.runs.composition import compose
from ia_bench.runs.config import SceneConfig, resolve_scene_folder
from ia_bench.runs.execute import execute
from ia_bench.runs.folder import CURVE
from ia_bench_baselines.mitsuba_adam.scene import import_mitsuba

SCENE = "tiny"
PRIORS = ("oracle", "none")
DEFAULT = (4096, 32)
SPLITS = (DEFAULT, (4096, 8), (4096, 128), (1024, 32), (16384, 32))  # fit.pixels and render.samples
BUDGETS = (120, 240, 480)  # steps of the default split, a third of them in stage 2
QUICK_BUDGETS = (60,)
MITSUBA, MITSUBA_SAMPLES = "Mitsuba 3 + Adam, 1 view x 128 samples", 128
METHOD = "ia_bench_baselines.mitsuba_adam.method:MitsubaAdam"
METRICS = {
    "aligned_albedo_psnr": ("aligned_albedo", "psnr"),
    "view_synthesis_psnr": ("view_synthesis", "psnr"),
    "relighting_psnr": ("relighting", "psnr"),
    "roughness_mse": ("roughness", "mse"),
}


@dataclass(frozen=True)
class Setting:
    """A fit: its prior, ``fit.pixels``, ``render.samples`` and the number of steps that the budget leaves."""

    prior: str
    pixels: int
    samples: int
    steps: int

    @classmethod
    def of(cls, prior: str, split: tuple[int, int], budget: int) -> Setting:
        """The setting that draws as many samples as ``budget`` steps of the default split."""
        pixels, samples = split
        return cls(prior, pixels, samples, round(budget * DEFAULT[0] * DEFAULT[1] / (pixels * samples)))

    @property
    def case(self) -> str:
        """Its line in the figure."""
        return f"{self.pixels} pixels x {self.samples} samples"

    def overrides(self, out: Path, threads: int) -> list[str]:
        """The command line of the run."""
        second = self.steps // 3
        return [
            f"scene={SCENE}", f"prior={self.prior}", f"fit.pixels={self.pixels}", f"render.samples={self.samples}",
            f"fit.stage1_steps={self.steps - second}", f"fit.stage2_steps={second}", f"threads={threads}", "device=cpu",
            f"out={out}", "render.bounces=0", "render.coat=added",
        ]  # fmt: skip


class MitsubaSetting(Setting):
    """The same of the plain loop; ``pixels``: of the object in a view."""

    case = MITSUBA

    def overrides(self, out: Path, threads: int) -> list[str]:
        """The command line of the run."""
        told = ["prior.options.components=[albedo]"] if self.prior == "oracle" else []
        return [
            f"scene={SCENE}", f"prior={self.prior}", *told, f"method={METHOD}", f"method.options.steps={self.steps}",
            f"render.samples={self.samples}", f"threads={threads}", "device=cpu", f"out={out}", "render.bounces=0",
        ]  # fmt: skip


def measure(*, threads: int, quick: bool) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of inverse.csv, and the summary: per prior and budget, each split's albedo against the default's."""
    rows, budgets = [], QUICK_BUDGETS if quick else BUDGETS
    with tempfile.TemporaryDirectory() as folder:
        for prior in PRIORS:
            for split in SPLITS[:2] if quick else SPLITS:
                rows += [measure_one(Setting.of(prior, split, budget), budget, Path(folder), threads) for budget in budgets]
        try:
            import_mitsuba(threads)
        except InputError as error:
            return rows, _summary(rows) | {"left_out": f"Mitsuba 3: {error}"}
        views = NativeReader(resolve_scene_folder(SceneConfig(SCENE))).read(truth=False).train
        split = round(sum(int((view.mask > 0).sum()) for view in views) / len(views)), MITSUBA_SAMPLES
        for prior in PRIORS:
            settings = [(MitsubaSetting.of(prior, split, budget), budget) for budget in budgets]
            rows += [measure_one(setting, budget, Path(folder), threads) for setting, budget in settings]
    return rows, _summary(rows)


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    ours = [row for row in rows if row["case"] != MITSUBA]
    return {"scene": SCENE, "against_default": against_default(ours)}


def measure_one(setting: Setting, budget: int, folder: Path, threads: int) -> dict[str, Any]:
    """One run; a run that fails is a row with the reason."""
    row: dict[str, Any] = {"case": setting.case, **vars(setting), "budget": budget, "seconds": None}
    row |= {"cpu_s": None} | dict.fromkeys(METRICS) | {"failure": ""}
    out = folder / f"{setting.prior}-{setting.pixels}-{setting.samples}-{budget}"
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        metrics = execute(compose(setting.overrides(out, threads)))[0].metrics
    except Exception as error:  # a failure is a row of the table
        return row | {"failure": f"{type(error).__name__}: {error}"}
    share = (time.process_time() - cpu) / (time.perf_counter() - wall)
    with (out / CURVE).open(newline="") as file:
        curve = list(csv.DictReader(file))
    steps, seconds = [int(line["step"]) for line in curve], [float(line["seconds"]) for line in curve]
    row["seconds"] = without_compilation(steps, seconds)[-1]
    row["cpu_s"] = row["seconds"] * share
    for name, (component, metric) in METRICS.items():
        row[name] = metrics[component][metric]
    return row


def against_default(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Aligned albedo of each split less that of the default, in dB, at the same budget: prior and case -> mean over budgets."""
    found: dict[str, dict[str, float]] = {}
    default = f"{DEFAULT[0]} pixels x {DEFAULT[1]} samples"
    value = {(row["prior"], row["case"], row["budget"]): row["aligned_albedo_psnr"] for row in rows}
    for prior in dict.fromkeys(row["prior"] for row in rows):
        for case in dict.fromkeys(row["case"] for row in rows):
            pairs = [(value[prior, case, b], value[prior, default, b]) for b in dict.fromkeys(row["budget"] for row in rows)]
            known = [mine - reference for mine, reference in pairs if mine is not None and reference is not None]
            if known:
                found.setdefault(prior, {})[case] = sum(known) / len(known)
    return found
