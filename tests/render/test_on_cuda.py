"""What a GPU computes against the CPU: rays, a step with its gradients and its control variate, one fit."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.cli.main import main
from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.render.renderer import Renderer
from ia_bench.render.stage import Stage
from ia_bench.scenes.scene import Scene

pytestmark = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU that torch finds")]
DEVICES = ("cpu", "cuda")
PIXELS = 512
LIGHT = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(2)) ** 4


def stages(scene: Scene) -> list[Stage]:
    return [Stage(scene.expect_mesh(), torch.device(name)) for name in DEVICES]


def test_rays_meet_the_same_triangles(tiny: Scene) -> None:
    """But for those at an edge: one in a thousand."""
    rng = torch.Generator().manual_seed(0)
    origins = 3 * torch.nn.functional.normalize(torch.randn(4096, 3, generator=rng), dim=-1)
    directions = torch.nn.functional.normalize(torch.randn(4096, 3, generator=rng) * 0.3 - origins, dim=-1)
    found = [stage.rays.intersect(origins.to(stage.device), directions.to(stage.device)) for stage in stages(tiny)]
    blocked = [stage.rays.occluded(origins.to(stage.device), directions.to(stage.device)).cpu() for stage in stages(tiny)]
    face, distance = ([part[index].cpu() for part in found] for index in (0, 2))
    same = face[0] == face[1]
    assert same.float().mean() > 0.999
    assert (face[0] >= 0).any()
    torch.testing.assert_close(distance[0][same], distance[1][same], rtol=1e-4, atol=1e-5)
    assert (blocked[0] == blocked[1]).float().mean() > 0.999


@pytest.mark.parametrize("controlled", [False, True])
def test_a_step_and_its_gradients_agree(tiny: Scene, controlled: bool) -> None:
    """The same samples: the mean pixel to 1e-3 of it, gradients to 1 % of their norm (a few samples choose another texel)."""
    truth = tiny.truth
    rotation = torch.rand(2, PIXELS, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    seen = []
    for stage in stages(tiny):
        renderer = stage.renderer(bounces=1, coat="layered", control_variate=controlled)
        seen.append([part.cpu() for part in _step(renderer, stage, tiny, truth.albedo, truth.roughness, rotation)])
    (radiance, *gradients), (radiance_there, *gradients_there) = seen
    assert float((radiance - radiance_there).abs().mean()) < 1e-3 * float(radiance.abs().mean())
    for here, there in zip(gradients, gradients_there, strict=True):
        assert float((here - there).norm()) < 0.01 * float(here.norm())


def _step(
    renderer: Renderer, stage: Stage, scene: Scene, albedo: np.ndarray, roughness: np.ndarray, rotation: Tensor
) -> list[Tensor]:
    leaves = [torch.from_numpy(albedo).float(), torch.from_numpy(roughness)[..., None].float(), LIGHT]
    leaves = [leaf.to(stage.device).clone().requires_grad_() for leaf in leaves]
    gbuffer = stage.gbuffer([view.camera for view in scene.test], 2)
    pixels = torch.arange(0, len(gbuffer.pixel), max(1, len(gbuffer.pixel) // PIXELS), device=stage.device)[:PIXELS]
    material, light = Material(leaves[0], leaves[1].clamp_min(0.2)), SampledLight.of(leaves[2])
    bounced = renderer._bounce(gbuffer, material, light)
    found = renderer._render(
        gbuffer, pixels, material, light, bounced, 32, rotation[:, : len(pixels)].to(stage.device).contiguous()
    )
    return [found.radiance.detach(), *torch.autograd.grad(found.radiance.square().mean(), leaves)]


def test_a_fit_ends_with_the_scores_of_the_cpu(tmp_path: Path) -> None:
    """Within what seeds differ by on this scene."""
    scores = []
    for name in DEVICES:
        out = tmp_path / name
        assert main(["run", "scene=tiny", "preset=smoke", f"device={name}", "threads=1", f"out={out}"]) == 0
        scores.append(json.loads((out / "metrics.json").read_text())["metrics"])
    for group in ("aligned_albedo", "relighting", "view_synthesis"):
        assert scores[1][group]["psnr"] == pytest.approx(scores[0][group]["psnr"], abs=1.0), group
