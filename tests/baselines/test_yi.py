"""Yi et al.: spherical-harmonic shading against quadrature, the low-rank loss against numpy, training, and the prior."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y
from training.test_dataset import shard

from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench.light.latlong import row_solid_angles, texel_centres
from ia_bench.priors.contract import Observations
from ia_bench_baselines.yi.data import RelitRequest, make_data
from ia_bench_baselines.yi.networks import InverseRendering
from ia_bench_baselines.yi.prior import YiPrior
from ia_bench_baselines.yi.shading import chromaticity, irradiance, low_rank_loss, rank_one_distance
from ia_bench_baselines.yi.train import Settings, train
from ia_bench_training.shards import ShardInfo, write_shard


def real_harmonics(direction: np.ndarray) -> np.ndarray:
    """The nine real harmonics (T, 9) up to degree 2 in the module's order, from scipy's complex ones."""
    polar, azimuth = np.arccos(direction[:, 2].clip(-1, 1)), np.arctan2(direction[:, 1], direction[:, 0])
    columns = []
    for degree in range(3):
        for order in range(-degree, degree + 1):
            value = (-1) ** order * sph_harm_y(degree, abs(order), polar, azimuth)
            columns.append(value.real if order == 0 else math.sqrt(2) * (value.real if order > 0 else value.imag))
    return np.stack(columns, -1)


def test_irradiance_is_the_integral_of_the_light_times_the_clamped_cosine():
    """Constants to 1e-3, one harmonic at a time; the rest is that of 512 x 1024 directions."""
    direction = texel_centres(512, 1024).double().reshape(-1, 3).numpy()
    area = row_solid_angles(512, 1024).double().repeat_interleave(1024).numpy()
    harmonics = real_harmonics(direction)
    normals = torch.nn.functional.normalize(torch.randn(6, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    for k in range(9):
        found = irradiance(normals[..., None, None].double(), torch.eye(9, dtype=torch.float64)[k].expand(6, 9))[:, 0, 0, 0]
        for normal, value in zip(normals.double().numpy(), found, strict=True):
            expected = (harmonics[:, k] * np.maximum(direction @ normal, 0) * area).sum()
            assert abs(float(value) - expected) < 1e-3, (k, normal)


def test_the_distance_from_rank_one_is_numpys():
    stack = np.random.default_rng(0).normal(size=(40, 8))
    u, s, vh = np.linalg.svd(stack, full_matrices=False)
    expected = np.linalg.norm(stack - s[0] * np.outer(u[:, 0], vh[0]))
    assert float(rank_one_distance(torch.from_numpy(stack))) == pytest.approx(expected, rel=1e-12)


def test_one_paint_under_several_grey_lights_has_no_low_rank_loss():
    """Of albedos up to a factor for each light, and of chromaticities of any shading; pixels outside the mask do not count."""
    generator = torch.Generator().manual_seed(2)
    paint, mask = 0.2 + 0.6 * torch.rand(1, 3, 9, 7, generator=generator), torch.zeros(1, 9, 7)
    mask[:, 2:7, 1:6] = 1
    factors, light = torch.rand(4, 1, 1, 1, generator=generator), 0.1 + torch.rand(4, 1, 9, 7, generator=generator)
    outside = (1 - mask) * torch.rand(4, 3, 9, 7, generator=generator)
    assert float(low_rank_loss(paint * factors * mask + outside, mask)) < 1e-4
    assert float(low_rank_loss(chromaticity(paint * light / 1.1), mask)) < 1e-4
    assert float(low_rank_loss(paint * light, mask)) > 0.1


def test_a_resumed_run_ends_with_the_very_same_weights(tmp_path: Path):
    """Across the change from supervised steps to low rank."""
    write_shard(tmp_path / "relit_00000.safetensors", shard(16, 64), ShardInfo(0, 0, 16, 64))
    common = {"data": tmp_path, "supervised_steps": 2, "held_out": 1, "validate_steps": 2}
    train(Settings(out=tmp_path / "whole", steps=4, **common), Progress())  # type: ignore[arg-type]
    for steps in (1, 3, 4):
        train(Settings(out=tmp_path / "parts", steps=steps, **common), Progress())  # type: ignore[arg-type]
    states = (torch.load(tmp_path / name / "state.pt", weights_only=True) for name in ("whole", "parts"))
    whole, parts = (state["parts"]["trainee"]["networks"] for state in states)
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


def test_objects_beyond_those_asked_for_and_of_another_seed_are_refused(tmp_path: Path):
    """Training takes all files of a folder."""
    for number in range(2):
        info = ShardInfo(seed=0, first=8 * 16 * number, count=8 * 16, size=8)
        write_shard(tmp_path / f"relit_{number:05d}.safetensors", shard(8 * 16, 8), info)
    for asked, found in (({"objects": 16}, "found 32 of seed 0"), ({"objects": 32, "seed": 1}, "found 16 of seed 0")):
        with pytest.raises(InputError, match=f"{found}. Give another out= folder"):
            make_data(RelitRequest(tmp_path, **{"seed": 0, **asked}), Progress())


def test_specular_shading_is_the_linear_image_less_the_linear_diffuse_one():
    """With a Spec-Net that finds the same everywhere, S = 1/4, and a picture that fills the frame."""
    prior = YiPrior()
    network = InverseRendering().eval()
    with torch.no_grad():
        network.specular.output[-2].weight.zero_()
        network.specular.output[-2].bias.fill_(math.atanh(-0.5))
    prior.__dict__["_network"] = network
    image = torch.full((1, 64, 64, 3), 0.3)
    found = prior.sample(Observations(image, torch.ones(1, 64, 64)), seed=0).values["specular"]
    display = 1.055 * 0.7 ** (1 / 2.4) - 0.055
    expected = 0.7 - ((display - 0.25 + 0.055) / 1.055) ** 2.4
    torch.testing.assert_close(found, torch.full_like(found, expected * 0.3 / 0.7), rtol=1e-3, atol=0)
