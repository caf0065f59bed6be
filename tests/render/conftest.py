"""The scene `tiny` as the renderer wants it."""

import numpy as np
import pytest
import torch
from stage import Stage

from ia_bench.material.textures import Material
from ia_bench.scenes.scene import Scene


@pytest.fixture(scope="session")
def tiny_stage(tiny: Scene) -> Stage:
    """The test views of `tiny`, one point a pixel."""
    return Stage(tiny.mesh, [view.camera for view in tiny.test])


@pytest.fixture(scope="session")
def tiny_material(tiny: Scene) -> Material:
    """Ground truth, with roughness of at least 0.5: so rough that brute force can integrate it."""
    roughness = np.maximum(tiny.truth.roughness, 0.5)[..., None]
    return Material(torch.from_numpy(tiny.truth.albedo).float(), torch.from_numpy(roughness).float())


@pytest.fixture(scope="session")
def soft_light(tiny: Scene) -> torch.Tensor:
    """The studio light of `tiny`, (64, 128, 3): no sun, so that brute force can integrate it."""
    return torch.from_numpy(tiny.truth.lights["studio"])


@pytest.fixture(scope="session")
def tiny_sun(tiny: Scene) -> torch.Tensor:
    """The training light of `tiny`, (64, 128, 3): a small bright sun."""
    return torch.from_numpy(tiny.truth.lights["train"])
