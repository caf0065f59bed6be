"""How much noise the control variate of diffuse light takes out of a step of a fit, and what it takes longer.

    python -m benchmarks.control_variate hat ship console figurine

For the true material and light of each scene: the variance over estimates of a step's pixels and of its gradients, with the
control variate as a share of that without, and CPU time of both, in turns. A fit draws two halves of these samples, a fifth of
them evenly over the sphere; here they are one estimate, by the light alone. Means are compared, too: by how many standard errors
those of the pixels differ, which is normal of unit variance or less where nothing is moved.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import torch
from torch import Tensor

from benchmarks.stage import TrueScene
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.renderer import Renderer

PIXELS, SAMPLES, LIGHT_ROWS, BOUNCES = 2048, 32, 32, 2  # of a step of preset=quick
GRADIENTS = ("albedo", "roughness", "light")


class Estimate(NamedTuple):
    """One step: radiance (P, 3), gradients of its mean by name, and CPU milliseconds."""

    radiance: Tensor
    gradients: dict[str, Tensor]
    milliseconds: float


def estimate(renderer: Renderer, stage: TrueScene, pixels: Tensor, views: int, generator: torch.Generator) -> Estimate:
    """Render and differentiate once."""
    gbuffer = stage.gbuffer([view.camera for view in stage.scene.train[:views]])
    leaves = [values.clone().requires_grad_() for values in (stage.material.albedo, stage.material.roughness, stage.light)]
    material = Material(*leaves[:2], stage.material.metallic)
    started = time.process_time()
    rendered = renderer.render_pixels(gbuffer, pixels, material, SampledLight.of(leaves[2]), SAMPLES, generator)
    gradients = torch.autograd.grad(rendered.radiance.mean(), leaves)
    spent = 1e3 * (time.process_time() - started)
    return Estimate(rendered.radiance.detach(), dict(zip(GRADIENTS, gradients, strict=True)), spent)


def main() -> None:
    """Print a line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--times", type=int, default=40, help="estimates of each (default: %(default)s)")
    parser.add_argument("--views", type=int, default=20, help="training views (default: %(default)s)")
    wanted = parser.parse_args()
    print("| scene | radiance: mean, median pixel | gradients: " + ", ".join(GRADIENTS) + " | ms | standard errors |")
    print("| :--- | ---: | ---: | ---: | ---: |")
    for name in wanted.scenes:
        stage = TrueScene.of(name, light_rows=LIGHT_ROWS, threads=1)
        renderers = [stage.geometry.renderer(bounces=BOUNCES, control_variate=controlled) for controlled in (False, True)]
        generator = torch.Generator().manual_seed(0)
        entries = len(stage.gbuffer([view.camera for view in stage.scene.train[: wanted.views]]).pixel)
        pixels = torch.randperm(entries, generator=generator)[:PIXELS]
        turns = [[estimate(one, stage, pixels, wanted.views, generator) for one in renderers] for _ in range(wanted.times)]
        plain, controlled = zip(*turns, strict=True)
        radiance = [torch.stack([each.radiance for each in estimates]) for estimates in (plain, controlled)]
        variance = [values.var(0) for values in radiance]
        shares = [variance[1].mean() / variance[0].mean(), (variance[1] / variance[0].clamp_min(1e-12))[variance[0] > 0].median()]
        left = []
        for which in GRADIENTS:
            sums = [torch.stack([each.gradients[which] for each in estimates]).var(0).sum() for estimates in (plain, controlled)]
            left.append(float(sums[1] / sums[0]))
        spent = [sorted(each.milliseconds for each in estimates)[wanted.times // 2] for estimates in (plain, controlled)]
        seen = sum(variance) > 0
        off = (radiance[1].mean(0) - radiance[0].mean(0))[seen] / (sum(variance)[seen] / wanted.times).sqrt()
        print(
            f"| {name} | {shares[0]:.2f}, {shares[1]:.2f} | {', '.join(f'{share:.2f}' for share in left)} "
            f"| {spent[0]:.1f}, {spent[1]:.1f} | {off.mean():+.2f}, {off.std():.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
