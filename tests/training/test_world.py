"""Worlds: what their images have to be, and that nothing on which results are measured gets into one."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from training.test_dataset import shard
from training.test_loop import folders, same_process, train  # noqa: F401 (fixtures)

from ia_bench.common.arguments import read_arguments
from ia_bench.common.errors import InputError
from ia_bench.common.progress import Progress
from ia_bench_training.settings import TrainSettings
from ia_bench_training.shards import ShardInfo, shard_path, write_shard
from ia_bench_training.world import banks, held_out, views
from ia_bench_training.world.held_out import SEED, HeldOutRequest, make_held_out
from ia_bench_training.world.images import Mixture, WorldImages
from ia_bench_training.world.layout import DIRECTIONS, LOBES, WORLD, directions, filtered
from ia_bench_training.world.make import WorldRequest, _meshes, _trace, make_world
from ia_bench_training.world.shade import Dice, Shader
from ia_bench_training.world.travel import TravelRequest, reduce

ROOT = Path(__file__).parents[2]
SIZE = 16


def request(folder):
    return WorldRequest(folder, real=Path("none"), objects=2, views=2, size=SIZE, tiles=6, lights=2)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("world")
    with Progress() as progress:
        make_world(request(folder), progress)
    return folder


def test_directions_are_spread_evenly():
    assert directions().norm(dim=1).sub(1).abs().max() < 1e-5
    assert directions().mean(0).norm() < 1e-3
    assert (directions() @ directions().T - 2 * torch.eye(DIRECTIONS)).amax(1).min() > np.cos(np.radians(11))


def test_under_an_even_light_the_irradiance_is_the_ambient_visibility_and_a_white_mirror_shows_the_light():
    normal = torch.nn.functional.normalize(torch.randn(1, 50, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    free = torch.full((1, 50, DIRECTIONS // 8), 255, dtype=torch.uint8)
    half = free.clone()
    half[..., ::2] = 0
    light = torch.ones(1, 3, len(LOBES), banks.HEIGHT, banks.WIDTH)
    one = torch.ones(1, 50, 1)
    for sky, expected in ((free, 1.0), (half, 0.5)):
        irradiance, specular, mirrored, ambient, left = Shader(torch.device("cpu"))(
            light, normal, normal, sky, one.expand(-1, -1, 3), 0.1 * one, one
        )
        assert abs(float(ambient.mean()) - expected) < 0.05
        torch.testing.assert_close(irradiance, ambient.expand(-1, -1, 3), rtol=0.06, atol=0.02)
        torch.testing.assert_close(specular + mirrored, torch.ones_like(specular), rtol=0.06, atol=0)
        assert ((left > 0.9) & (left < 1)).all()


def test_a_lamp_lights_what_faces_it_and_is_mirrored_there():
    lamp = torch.zeros(1, banks.HEIGHT, banks.WIDTH, 3)
    lamp[0, 20, 37] = 1
    normal = banks.texel_centres(16, 32).reshape(1, -1, 3)
    count = normal.shape[1]
    one, sky = torch.ones(1, count, 1), torch.full((1, count, DIRECTIONS // 8), 255, dtype=torch.uint8)
    shaded = Shader(torch.device("cpu"))(filtered(lamp).float(), normal, normal, sky, one.expand(-1, -1, 3), 0.4 * one, one)
    toward = banks.texel_centres(banks.HEIGHT, banks.WIDTH)[20, 37]
    for light in shaded[:2]:
        assert normal[0, light[0, :, 0].argmax()] @ toward > np.cos(np.radians(9))


def test_a_filtered_light_keeps_its_mean_and_gets_smoother():
    light = banks.procedural_light(np.random.default_rng(3))
    maps = filtered(light[None])[0].float()
    area = banks.row_solid_angles(banks.HEIGHT, banks.WIDTH).float()[:, None]
    means = (maps * area).sum((-2, -1)).mean(0) / (4 * np.pi)
    torch.testing.assert_close(means, torch.ones(len(LOBES)), rtol=0.1, atol=0)
    assert maps.flatten(2).std(-1).mean(0).diff().max() < 0


def test_whole_numbers_stay_below_their_end(monkeypatch):
    """The largest number that torch draws, added to a bank's many real textures, is rounded up to the end of the bank."""
    monkeypatch.setattr(torch, "rand", lambda *shape, **at: torch.full(shape, 1 - 2.0**-24))
    for low, high in ((0, 600), (1576, 2176), (120, 270)):
        assert Dice(torch.Generator()).integers(low, high, 3).tolist() == [high - 1] * 3


def test_images_are_what_they_say(world):
    images = WorldImages(world, Mixture())
    index = torch.arange(len(images))
    found, again = (images.linear(index, torch.Generator().manual_seed(5)) for _ in range(2))
    assert all(torch.equal(found[name], again[name]) for name in found)
    other = images.linear(index, torch.Generator().manual_seed(6))
    assert not torch.equal(other["albedo"], found["albedo"])
    assert torch.equal(other["normal"], found["normal"])
    assert all(torch.isfinite(values).all() for values in found.values())
    coverage = found["image"][..., 3:]
    assert all((values[(coverage == 0).expand_as(values)] == 0).all() for values in found.values())
    assert (found["image"][..., :3] - found["specular"]).min() > -1e-5
    inside = (coverage == 1)[..., 0]
    for name, low, high in (("albedo", 0.02, 0.95), ("roughness", 0.05, 1), ("metallic", 0, 1), ("visibility", 0, 1)):
        assert found[name][inside].min() >= low - 1e-5
        assert found[name][inside].max() <= high + 1e-5
    mean = found["image"][..., :3].mean(-1).sum((1, 2)) / coverage.sum((1, 2, 3))
    torch.testing.assert_close(mean, torch.full_like(mean, 0.3), rtol=1e-3, atol=0)


def test_a_world_that_travels_shows_the_same_views(world, tmp_path):
    reduce(TravelRequest(world, tmp_path, every=1, lights=2))
    here, there = (
        WorldImages(folder, Mixture()).linear(torch.arange(2), torch.Generator().manual_seed(5)) for folder in (world, tmp_path)
    )
    assert torch.equal(here["normal"], there["normal"])
    for name in ("albedo", "image", "roughness"):
        assert (here[name] - there[name]).abs().mean() < 0.02, name
    for start, out, found in ((tmp_path, tmp_path / "on", "found one that has travelled"), (world, world, "found the same")):
        with pytest.raises(InputError, match=found):
            reduce(TravelRequest(start, out))


def test_a_network_trains_on_a_world_and_goes_on(world, folders, tmp_path):  # noqa: F811
    small = ["network.size=16", "network.channels=[16,32]", "network.tokens=16", "network.kind=regressor", "batch=2"]
    quick = ["compile=false", "validate_steps=2", "validation_images=2", "precision=float32", "threads=1", "scenes=[tiny]"]
    line = [f"data={world}", f"validation={folders / 'validation'}", f"out={tmp_path}", *small, *quick]
    train([*line, "steps=1"])
    shown = train([*line, "steps=2"])
    assert "tiny_one" in (tmp_path / "validation.jsonl").read_text() or "tiny_one" in shown.stderr


def test_a_world_is_not_changed_under_a_training(world, tmp_path):
    with Progress() as progress:
        for other in ({"seed": 1}, {"tiles": 7}, {"lights": 3}):
            with pytest.raises(InputError, match="give another out= folder"):
                make_world(replace(request(world), **other), progress)
        beyond = world / "views_procedural_0001.safetensors"
        beyond.touch()
        with pytest.raises(InputError, match="expected the views of objects=2, found more; give another out= folder"):
            make_world(request(world), progress)
        beyond.unlink()
        (tmp_path / WORLD).write_text((world / WORLD).read_text()[:9])  # of a copy that broke off
        with pytest.raises(InputError, match=r"world\.json: not valid JSON"):
            make_world(request(tmp_path), progress)
    with pytest.raises(InputError, match=r"world\.make makes them"):
        WorldImages(tmp_path, Mixture())
    for path in (tmp_path / "objects/mine/chair.glb", tmp_path / "objects/mine/table.glb"):  # without any, and with one of no list
        with pytest.raises(InputError, match="expected the folder of `make real-data`"):
            _meshes(tmp_path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")


def test_a_world_gets_the_objects_that_it_lacks(tmp_path, monkeypatch):
    """A last file of fewer than 25 objects is made again where more are asked for, or fewer, and else kept."""
    monkeypatch.setattr(views, "procedural", lambda rng: views.Shape(*[None] * 5, -1))
    monkeypatch.setattr(views, "trace", lambda *_: [{"pixel": torch.zeros(1), "camera": torch.eye(3)}])
    path, made = tmp_path / "views_procedural_0000.safetensors", []
    for count in (1, 25, 25, 2):
        _trace(request(tmp_path), 0, count, [])
        made.append((len(load_file(path)["atlas"]), path.stat().st_mtime_ns))
    assert [count for count, _ in made] == [1, 25, 25, 2]
    assert made[2] == made[1]


def test_meshes_that_nothing_can_draw_leave_no_views(tmp_path):
    (tmp_path / "mesh.glb").write_bytes(b"none")
    _trace(request(tmp_path), 0, 0, [tmp_path / "mesh.glb"])
    assert not list(tmp_path.glob("views_*"))


def test_held_out_images_of_another_size_are_refused(tmp_path):
    write_shard(shard_path(tmp_path, 0), shard(1, SIZE), ShardInfo(SEED, 0, 1, SIZE))
    make_held_out(HeldOutRequest(tmp_path, size=SIZE), Progress())
    with pytest.raises(InputError, match="expected images of size=64, found 16; give another out= folder"):
        make_held_out(HeldOutRequest(tmp_path), Progress())


def test_held_out_objects_that_are_absent_are_not_left_out(tmp_path, monkeypatch):
    real = tmp_path / "real"
    monkeypatch.setattr(held_out, "read_light", lambda path: np.ones((2, 4, 3)))
    names = ["lights/a.hdr", "objects/b/c.glb"]
    monkeypatch.setattr(held_out, "closed_set", lambda name: names)
    for name, expected in zip([*names, ""], [*names, "textures do not repeat, found none"], strict=True):
        with pytest.raises(InputError, match=expected):
            make_held_out(HeldOutRequest(tmp_path, real), Progress())
        if name:
            (real / name).parent.mkdir(parents=True)
            (real / name).write_bytes(b"none")


def test_training_needs_no_renderer():
    """A machine that trains on a world that has travelled has PyTorch, and none of these (training/on_gpu.sh)."""
    absent = ["warp", "embreex", "hydra", "omegaconf", "trimesh", "xatlas", "OpenEXR", "scipy", "skimage"]
    code = f"import sys; sys.modules.update(dict.fromkeys({absent})); import ia_bench_training.train, ia_bench_training.loop"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("file", "first"), [("Makefile", "prior: setup"), ("training/on_gpu.sh", "ia_bench_training.train data=")])
def test_the_recipes_name_settings_that_there_are(file: str, first: str) -> None:
    """What `make prior` and a machine with a GPU give to training, where a setting of another name would end it at once."""
    recipe = (ROOT / file).read_text(encoding="utf-8").partition(first)[2].partition("\n\n")[0]
    given = re.findall(r"\b([a-z_.]+=(?:[\d.e-]+|false|true))\b", recipe)
    assert len(given) > 8
    settings = read_arguments(TrainSettings, ["data=a", "validation=b", "out=c", "network.kind=regressor", *given])
    assert settings.log_error == 0.01
