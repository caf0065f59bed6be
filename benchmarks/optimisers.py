"""Optimisers and parametrisations of the light on the image loss alone: error against CPU seconds.

    python benchmarks/optimisers.py SCENE_FOLDER --out FOLDER [--only adam gauss-newton ...] [--steps 600] [--pixels 1024]

Every case minimises the trainer's objective without a prior (L1 of tone-mapped radiance and smoothness) from the trainer's own
start, on batches of random pixels, with the textures' late starts and with rates that fall to 5 % over the case. A case that
does more work a step takes fewer steps, so that all cost about the same. Torch renders for all, eagerly: second-order methods need
derivatives that the renderer's kernels have not, so this favours them. Scores (off the clock) are the curve's: every fourth view.

"adam": the trainer's. "adam, one rate x": the same rate for everything. "diagonal": momentum, divided by the diagonal of the
Gauss-Newton matrix (Hutchinson's estimate, one more backward pass a step). "gauss-newton": Levenberg-Marquardt, ten iterations of
conjugate gradients a step on one batch with fixed samples, damping adapted, L1 by reweighting. "l-bfgs": ten iterations with a
line search a step on one batch, in units of the rates. The others are Adam on other parameters of the light: "linear"
(radiance over its mean at the start, projected to be positive), "softplus" (of the same), "log + scale" (a factor a channel
besides), "log pyramid" (means of blocks of 2, 4, ... texels besides).
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from matplotlib.figure import Figure
from objective import FORMS, Objective, Parameters, Unknowns
from torch import Tensor

from benchmarks.stiffness.gauss_newton import Jacobian
from ia_bench.light.latlong import SampledLight
from ia_bench.methods.contract import Monitor, Problem
from ia_bench.methods.two_stage.method import TwoStage
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.readers.native import NativeReader
from ia_bench.render.reconstruction import TexturedReconstruction
from ia_bench.render.settings import RenderSettings
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

SCORED = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0)  # of the steps
INNER = 10  # iterations of conjugate gradients or of L-BFGS a step
COLUMNS = ("objective", "aligned_albedo_psnr", "view_synthesis_psnr", "relighting_psnr", "roughness_mse")

Clock = Callable[[int, Unknowns], None]


@dataclass(frozen=True)
class Case:
    """How one name is run: a rate for each leaf, the optimiser, and how many steps of Adam one of its steps costs."""

    run: Callable[[Unknowns, Objective, Case, FitSettings, int, int, Clock], None]
    form: str = "log"
    cost: float = 1.0
    rates: tuple[float, float, float] = (0.03, 0.1, 0.2)  # albedo, roughness, light

    def rate(self, name: str) -> float:
        """Of one leaf."""
        return {"albedo": self.rates[0], "roughness": self.rates[1]}.get(name, self.rates[2])


def run_adam(
    unknowns: Unknowns, objective: Objective, case: Case, settings: FitSettings, steps: int, pixels: int, clock: Clock
) -> None:
    """As the trainer does it."""
    leaves = {**unknowns.light, **unknowns.textures}
    adam = torch.optim.Adam([{"params": [leaf], "name": name} for name, leaf in leaves.items()], betas=(0.9, 0.99), fused=True)
    for step, chosen in enumerate(batches(objective, steps, pixels)):
        progress = step / max(steps - 1, 1)
        for group in adam.param_groups:
            group["lr"] = case.rate(group["name"]) * settings.rates.final**progress
        residual, weight = objective.residuals(unknowns, chosen, step)
        adam.zero_grad()
        (residual.abs() * weight).sum().backward()
        moving = unknowns.moving(step / steps, settings)
        for name, leaf in leaves.items():
            if name not in moving:
                leaf.grad = None
        adam.step()
        unknowns.project()
        clock(step + 1, unknowns)


def run_diagonal(
    unknowns: Unknowns, objective: Objective, case: Case, settings: FitSettings, steps: int, pixels: int, clock: Clock
) -> None:
    """Momentum 0.9 divided by a running mean of the diagonal, damped by 3 % of its mean over the leaf."""
    noise = torch.Generator().manual_seed(1)
    slope: Parameters = {}
    bend: Parameters = {}
    age: dict[str, int] = {}
    for step, chosen in enumerate(batches(objective, steps, pixels)):
        moving = unknowns.moving(step / steps, settings)
        squares, _ = objective.squares(unknowns, chosen, step)
        gradients = torch.autograd.grad(squares, list(moving.values()), squares.detach(), retain_graph=True)
        signs = torch.randint(0, 2, squares.shape, generator=noise).to(squares) * 2 - 1
        probes = torch.autograd.grad(squares, list(moving.values()), signs)
        rate = 0.1 * settings.rates.final ** (step / max(steps - 1, 1))
        for (name, leaf), gradient, probe in zip(moving.items(), gradients, probes, strict=True):
            age[name] = age.get(name, 0) + 1
            slope[name] = 0.9 * slope.get(name, torch.zeros_like(leaf)) + 0.1 * gradient
            bend[name] = 0.99 * bend.get(name, torch.zeros_like(leaf)) + 0.01 * probe**2
            mean, curvature = slope[name] / (1 - 0.9 ** age[name]), bend[name] / (1 - 0.99 ** age[name])
            change = rate * mean / (curvature + 0.03 * curvature.mean()).clamp_min(1e-20)
            with torch.no_grad():
                leaf.sub_(change.clamp(-5 * case.rate(name), 5 * case.rate(name)))
        unknowns.project()
        clock(step + 1, unknowns)


def run_gauss_newton(
    unknowns: Unknowns, objective: Objective, case: Case, settings: FitSettings, steps: int, pixels: int, clock: Clock
) -> None:
    """Levenberg-Marquardt: (J^T J + damping D) x = -J^T r by conjugate gradients preconditioned with D."""
    noise, damping = torch.Generator().manual_seed(1), 0.1
    for step, chosen in enumerate(batches(objective, steps, pixels)):
        moving = unknowns.moving(step / steps, settings)
        squares, before = objective.squares(unknowns, chosen, step)
        jacobian = Jacobian(squares, moving)
        signs = torch.randint(0, 2, (4, *squares.shape), generator=noise).to(squares) * 2 - 1
        diagonal = torch.stack([jacobian.backward(z) for z in signs]).square().mean(0)
        limit = torch.zeros_like(diagonal)
        for name, part in jacobian.slices.items():
            diagonal[part] += 0.03 * diagonal[part].mean()
            limit[part] = 10 * case.rate(name)  # ten steps of Adam
        target = -jacobian.backward(squares.detach())

        def product(vector: Tensor, jacobian: Jacobian = jacobian, added: Tensor = damping * diagonal) -> Tensor:
            return jacobian.backward(jacobian.forward(vector)) + added * vector

        change = conjugate_gradients(product, target, diagonal, INNER)
        change = settings.rates.final ** (step / max(steps - 1, 1)) * change.clamp(-limit, limit)
        expected = float(target @ change - 0.5 * jacobian.forward(change).square().sum())
        with torch.no_grad():
            for name, leaf in moving.items():
                leaf += change[jacobian.slices[name]].reshape(leaf.shape)
            unknowns.project()
            residual, weight = objective.residuals(unknowns, chosen, step)
            ratio = (before - float((residual.abs() * weight).sum())) / max(expected, 1e-12)
        damping = min(max(damping * (0.5 if ratio > 0.5 else 2.0 if ratio < 0.1 else 1.0), 1e-3), 1e2)
        clock(step + 1, unknowns)


def conjugate_gradients(product: Callable[[Tensor], Tensor], target: Tensor, diagonal: Tensor, iterations: int) -> Tensor:
    """An approximate solution of ``product(x) = target`` from zero, preconditioned with a positive ``diagonal``."""
    solution, rest = torch.zeros_like(target), target.clone()
    scaled = rest / diagonal
    direction, power = scaled.clone(), rest @ scaled
    for _ in range(iterations):
        moved = product(direction)
        length = power / (direction @ moved).clamp_min(1e-30)
        solution, rest = solution + length * direction, rest - length * moved
        scaled = rest / diagonal
        power, last = rest @ scaled, power
        direction = scaled + power / last.clamp_min(1e-30) * direction
    return solution


def run_lbfgs(
    unknowns: Unknowns, objective: Objective, case: Case, settings: FitSettings, steps: int, pixels: int, clock: Clock
) -> None:
    """A fresh memory for every batch: differences of gradients between batches are noise."""
    for step, chosen in enumerate(batches(objective, steps, pixels)):
        moving = unknowns.moving(step / steps, settings)
        origin = {name: leaf.detach().clone() for name, leaf in moving.items()}
        units = {name: torch.zeros_like(leaf, requires_grad=True) for name, leaf in moving.items()}
        size = settings.rates.final ** (step / max(steps - 1, 1))
        sampled = SampledLight.of(unknowns.radiance().detach(), uniform_fraction=settings.defensive_share)
        solver = torch.optim.LBFGS(list(units.values()), lr=size, max_iter=INNER, line_search_fn="strong_wolfe")

        def place(moving: Parameters = moving, origin: Parameters = origin, units: Parameters = units) -> None:
            with torch.no_grad():
                for name, leaf in moving.items():
                    leaf.copy_(origin[name] + case.rate(name) * units[name])
            unknowns.project()

        def closure(
            chosen: Tensor = chosen, step: int = step, sampled: SampledLight = sampled, units: Parameters = units
        ) -> Tensor:
            place()
            residual, weight = objective.residuals(unknowns, chosen, step, sampled)
            loss = (residual.abs() * weight).sum()
            for (name, unit), gradient in zip(units.items(), torch.autograd.grad(loss, list(moving.values())), strict=True):  # noqa: B023
                unit.grad = case.rate(name) * gradient
            return loss.detach()

        solver.step(closure)
        place()
        clock(step + 1, unknowns)


def batches(objective: Objective, steps: int, pixels: int) -> Iterable[Tensor]:
    """The same random pixels for every case, (pixels,) a step."""
    generator = torch.Generator().manual_seed(0)
    for _ in range(steps):
        yield torch.randint(objective.pixel_count, (pixels,), generator=generator)


CASES = {
    "adam": Case(run_adam),
    "adam, one rate 0.03": Case(run_adam, rates=(0.03, 0.03, 0.03)),
    "adam, one rate 0.1": Case(run_adam, rates=(0.1, 0.1, 0.1)),
    "adam, light 0.05": Case(run_adam, rates=(0.03, 0.1, 0.05)),
    "adam, light 0.4": Case(run_adam, rates=(0.03, 0.1, 0.4)),
    "diagonal": Case(run_diagonal, cost=1.1),
    "gauss-newton": Case(run_gauss_newton, cost=5.0),
    "l-bfgs": Case(run_lbfgs, cost=11.0),
    "linear": Case(run_adam, "linear"),
    "softplus": Case(run_adam, "softplus"),
    "log + scale": Case(run_adam, "log + scale"),
    "log pyramid": Case(run_adam, "log pyramid", rates=(0.03, 0.1, 0.1)),
}


class Scored:
    """The clock of a case: CPU seconds of its steps, scores beside them, off the clock."""

    def __init__(self, scorer: Scorer, objective: Objective, steps: int) -> None:
        self._scorer, self._objective, self._due = scorer, objective, {max(1, round(share * steps)) for share in SCORED}
        self.seconds = 0.0
        self.rows: list[dict[str, float]] = []
        self._started = time.process_time()

    def __call__(self, step: int, unknowns: Unknowns) -> None:
        """Stop the clock, score where it is due, go on."""
        self.seconds += time.process_time() - self._started
        if step in self._due:
            found = unknowns.reconstruction(self._objective.problem.stage)
            with torch.no_grad():
                residual, weight = self._objective.residuals(unknowns, self._objective.held, 2**32)
            scores = {
                **self._scorer.quick(found), "objective": float((residual.abs() * weight).sum())
            }  # fmt: skip
            values = {name: value for name in COLUMNS if (value := scores.get(name)) is not None}
            self.rows.append({"step": step, "seconds": self.seconds, **values})
        self._started = time.process_time()


def load(folder: Path, settings: FitSettings) -> tuple[Problem, Scorer, TexturedReconstruction]:
    """The problem that a run would have, how it would be scored, and where its trainer would start."""
    scene = NativeReader(folder).read(truth=True)
    problem = Problem(scene.blind(), RenderSettings(bounces=0, coat="added"), note=print)
    method = TwoStage(replace(settings, stage1_steps=0, stage2_steps=0))
    start = method.fit(problem, seed=0, monitor=Monitor.silent()).reconstruction
    assert isinstance(start, TexturedReconstruction)
    return problem, Scorer(scene, Protocol(), problem.device), start


def plot(path: Path, curves: dict[str, list[dict[str, float]]]) -> None:
    """Aligned albedo and relighting against CPU seconds."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    for axes, column in zip(figure.subplots(1, 2), ("aligned_albedo_psnr", "relighting_psnr"), strict=True):
        for number, (name, rows) in enumerate(curves.items()):
            usable = [row for row in rows if column in row]
            style = ("-", "--", ":")[number // 7]
            axes.plot([row["seconds"] for row in usable], [row[column] for row in usable], style, marker=".", label=name)
        label = column.removesuffix("_psnr").replace("_", " ")
        axes.set(xscale="log", xlabel="CPU seconds", ylabel=f"{label}, PSNR (dB)")
    axes.legend(fontsize="x-small")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run the cases one after the other, print and write their curves."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="scene folder with its truth")
    parser.add_argument("--out", type=Path, required=True, help="folder for optimisers.csv and optimisers.png")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), help="cases")
    parser.add_argument("--steps", type=int, default=600, help="steps of Adam; the others take as many as cost the same")
    parser.add_argument("--pixels", type=int, default=1024, help="in a batch")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    settings = FitSettings()
    problem, scorer, start = load(arguments.scene, settings)
    objective = Objective(problem, settings)
    arguments.out.mkdir(parents=True, exist_ok=True)
    curves: dict[str, list[dict[str, float]]] = {}
    print("| case | steps | CPU s | " + " | ".join(COLUMNS) + " |\n|" + " :--- |" * (3 + len(COLUMNS)))
    for name in arguments.only:
        case = CASES[name]
        steps = max(1, round(arguments.steps / case.cost))
        scored = Scored(scorer, objective, steps)
        case.run(Unknowns(start, FORMS[case.form]), objective, case, settings, steps, arguments.pixels, scored)
        curves[name] = scored.rows
        last = scored.rows[-1]
        shown = [f"{last[column]:.3f}" if column in last else "-" for column in COLUMNS]
        print(f"| {name} | {steps} | {last['seconds']:.1f} | " + " | ".join(shown) + " |", flush=True)
        with (arguments.out / "optimisers.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, ["case", "step", "seconds", *COLUMNS], lineterminator="\n")
            writer.writeheader()
            writer.writerows({"case": case_name, **row} for case_name, rows in curves.items() for row in rows)
        plot(arguments.out / "optimisers.png", curves)


if __name__ == "__main__":
    main()
