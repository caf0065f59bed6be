"""Whether an object has parts of metal, where nobody says: what two short fits make of photographs that neither has seen.

One fit is of a dielectric, the other has a metallic texture as well; all else is the same, whatever the prior, the method's options
and the seed of the run are, so that all rows of a table decide alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from ia_bench.methods.contract import Problem
from ia_bench.methods.monitor import Monitor
from ia_bench.methods.photographs import one_sided, restrict
from ia_bench.methods.plan import Decision
from ia_bench.methods.two_stage.fit import TwoStageFit
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.scenes.color import tone_map

GAIN = 0.5
"""Decibels that a metallic texture must gain. Further unknowns alone have gained up to .4 on things without metal, whose shape was
made of photographs; metal that is more than specks gains 1 to 4 (docs/log/real.md)."""
HELD_OUT, FEWEST = 3, 6
"""Every so many-th photograph is held out, where there are at least so many."""
SHORT = FitSettings(stage1_steps=80, stage2_steps=0, pixels=1024)
SAMPLES, TEXTURE, LIGHT_HEIGHT = 16, 128, 16
"""The short fits' samples of a pixel, and their most texels and rows of the light."""
JUDGED_PIXELS, JUDGED_SAMPLES = 8192, 64


def look_for_metal(problem: Problem) -> None:
    """Put into the problem's plan whether a metallic texture is recovered. The same problem always gives the same answer.

    Compared are tone-mapped photographs and renders, in decibels: 20 log10(1 / RMS). Of photographs whose exposures differ, renders
    are brought to their mean first. Light that bounces off the object is left out.
    """
    views, measured, saved = range(len(problem.scene.train)), dict[str, float](), "a metallic texture"
    if len(views) < FEWEST:
        why = f"{len(views)} photographs are too few to hold some out and see"
        problem.settle(Decision(False, why, {"photographs": float(len(views))}, saved, "render.metallic"))
        return
    with problem.costs.exclude("bake"):
        judged = views[1::HELD_OUT]
        for name, metallic in (("decibels_without", False), ("decibels_with", True)):
            fit = TwoStageFit(_part(problem, [view for view in views if view not in judged], metallic), SHORT, 0, Monitor.silent())
            fit.descent.descend()
            measured[name] = _decibels(fit, _part(problem, judged, metallic))
    without, by_metal = measured.values()
    found = by_metal - without >= GAIN
    why = f"{len(judged)} photographs that short fits did not see are met to {by_metal:.2f} dB with a metallic texture and "
    why += f"{without:.2f} without, {'at least' if found else 'less than'} {GAIN} dB more"
    problem.settle(Decision(found, why, measured, None if found else saved, "render.metallic"))


def _part(problem: Problem, views: Sequence[int], metallic: bool) -> Problem:
    """The problem of some of the photographs, without a prior, as a short fit has it."""
    scene, plan = problem.scene, problem.plan
    texture, light_height = min(plan.texture, TEXTURE), min(plan.light_height, LIGHT_HEIGHT)
    plan = replace(plan, samples=SAMPLES, texture=texture, light_height=light_height, bounces=0, metallic=metallic, decisions=[])
    few = replace(scene, train=tuple(scene.train[view] for view in views))
    part = Problem(few, problem.render, problem.device, note=lambda _: None)
    vars(part).update(stage=problem.stage, plan=plan, gbuffer=restrict(problem.gbuffer, tuple(views))[0])
    return part


@torch.no_grad()
def _decibels(fit: TwoStageFit, judged: Problem) -> float:
    """How well the fit meets the photographs of ``judged``."""
    photographs, generator = judged.photographs, torch.Generator(device=judged.device).manual_seed(0)
    entries = torch.nonzero(judged.gbuffer.filled & ~photographs.left_out)[:, 0]
    entries = entries[torch.randperm(len(entries), generator=generator, device=entries.device)[:JUDGED_PIXELS].sort().values]
    gbuffer, shown = judged.gbuffer.at(entries), photographs.radiance[entries]
    material, light = fit.parameters.material(detached=True), fit.parameters.light()
    rendered = judged.renderer.render_entries(gbuffer, material, light, JUDGED_SAMPLES, generator)["radiance"]
    if judged.scene.exposures_differ:
        both = torch.zeros(len(judged.scene.train), 2, 3, device=entries.device)
        both.index_add_(0, gbuffer.view(), torch.stack([shown, rendered], 1))
        both = both if judged.scene.white_balances_differ else both.sum(-1, keepdim=True)
        rendered = rendered * (both[:, 0] / both[:, 1].clamp_min(1e-12))[gbuffer.view()]
    shown = one_sided(shown, rendered, photographs.known[entries])
    difference = tone_map(photographs.unit * rendered) - tone_map(photographs.unit * shown)
    return -10 * math.log10(max(float(difference.square().sum()) / max(difference.numel(), 1), 1e-12))
