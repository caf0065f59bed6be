"""A step and fits whose device is the CPU under another name: tensors, generators and kernels of both devices never meet."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from pretended_device import MixedDevices, pretended_cuda

from ia_bench.light.latlong import SampledLight
from ia_bench.material.textures import Material
from ia_bench.methods.monitor import CostTracker, Monitor
from ia_bench.methods.validation import reconstruct
from ia_bench.render.reconstruction import Quality
from ia_bench.render.stage import Stage
from ia_bench.runs.composition import compose
from ia_bench.runs.config import method_of
from ia_bench.runs.run import problem_of
from ia_bench.scenes.scene import Scene

SMALL = ["preset=smoke", "render.texture=16", "render.light_height=16", "render.samples=4", "render.subsamples=1"]
SMALL += ["render.bounces=0"]
FIT = (*SMALL, "fit.stage1_steps=1", "fit.stage2_steps=1", "fit.pixels=32", "prior.views=2", "prior.cache=false")
ONE = {
    "nvdiffrec": "steps=1",
    "nvdiffrecmc": "steps=1",
    "neilfpp": "surface_light_steps=1 material_steps=1 joint_steps=1 pixels=8",
    "tensoir": "radiance_steps=1 coarse_steps=1 fine_steps=1 pixels=8 coarse=8 fine=16",
    "invrender": "radiance_steps=1 indirect_steps=1 steps=1 pixels=8 texture=16 width=16",
}
ROWS = {
    "refined": (*FIT, "prior=combined", "render.metallic=true"),
    "diffusion": (*FIT, "prior=diffusion", "coupling=targets", "prior.options.guidance_rule=paper"),
    "distilled": (*FIT, "prior=diffusion", "coupling=distilled"),
    **{name: (*SMALL, f"method={name}", *(f"method.options.{each}" for each in ONE[name].split())) for name in ONE},
}


@pytest.fixture
def cuda(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[torch.device]:
    with pretended_cuda(monkeypatch, tmp_path) as device:
        yield device


def test_the_pretence_tells_what_a_device_would_refuse(cuda: torch.device) -> None:
    there, here = torch.ones(3, device=cuda), torch.arange(3)
    assert (there[here] * 2 + torch.tensor(1.0)).device.type == "cuda"  # indices and single numbers may come from here
    assert here.to(there).device == there.device
    for wrong in (lambda: there + here, lambda: torch.cat([there, torch.ones(3)]), lambda: here[there.long()], there.numpy):
        with pytest.raises(MixedDevices):
            wrong()
    with pytest.raises(MixedDevices):
        torch.rand(3, device=cuda, generator=torch.Generator())


def test_a_step_with_its_gradients(cuda: torch.device, tiny: Scene) -> None:
    stage = Stage(tiny.expect_mesh(), cuda)
    renderer = stage.renderer(bounces=1, atlas_size=8, control_variate=True)
    leaves = [torch.full(shape, 0.5, device=cuda, requires_grad=True) for shape in ((8, 8, 3), (8, 8, 1), (16, 32, 3))]
    gbuffer = stage.gbuffer([tiny.test[0].camera], 2)
    rng = torch.Generator(device=cuda).manual_seed(0)
    pixels = torch.randint(len(gbuffer.pixel), (64,), generator=rng, device=cuda)
    found = renderer.render_pixels(gbuffer, pixels, Material(*leaves[:2]), SampledLight.of(leaves[2]), 8, rng)
    found.radiance.sum().backward()
    assert all(leaf.grad is not None and leaf.grad.device.type == "cuda" and bool(leaf.grad.any()) for leaf in leaves)


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS)
def test_a_fit_and_a_render(cuda: torch.device, tiny: Scene, row: str) -> None:
    """Of every baseline, prior and regulariser with tensors of its own."""
    config = compose([*ROWS[row], "scene=tiny", "device=cuda", "threads=1"])
    method = method_of(config)
    problem = problem_of(config, tiny, method.info, note=lambda line: None, costs=CostTracker())
    found = reconstruct(config.method.name, method, problem, seed=0, monitor=Monitor.silent()).reconstruction
    camera = [tiny.test[0].camera]
    assert set(found.maps(camera, ["albedo", "roughness"], points=1)) == {"albedo", "roughness"}
    if row in ONE:  # whose renderers are their own
        scale = torch.ones(3, device=cuda)
        drawn = found.render(camera, light=None, albedo_scale=scale, quality=Quality(points=1, samples=2))
        assert drawn is not None
        assert len(drawn) == 1
