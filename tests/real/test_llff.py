"""Real captures in LLFF's layout, read by their poses_bounds.npy, against their transforms.json."""

from pathlib import Path

import numpy as np
import pytest

from ia_bench.readers.llff import LlffReader
from ia_bench.readers.nerfstudio import NerfstudioReader


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tankard", "head", "gold_cape"])
def test_cameras_and_photographs_are_those_of_transforms(name: str, real_data: Path) -> None:
    folder = next((each for each in (real_data / "captures" / name, real_data / "nc" / "captures" / name) if each.is_dir()), None)
    if folder is None:
        pytest.skip(f"no {name} in {real_data}: make real-data NC=1")
    found, other = (reader(folder, shrink=8).read(truth=False) for reader in (LlffReader, NerfstudioReader))
    by_name = {Path(view.name).name: view for view in (*other.train, *other.test)}
    assert len(by_name) == len(found.train) + len(found.test)
    for view in (*found.train, *found.test):
        expected = by_name[view.name]
        np.testing.assert_allclose(view.camera.to_world, expected.camera.to_world, atol=1e-9)
        assert view.camera.focal == pytest.approx(expected.camera.focal)
        assert np.array_equal(view.image, expected.image)
