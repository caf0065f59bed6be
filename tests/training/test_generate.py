"""Training images as a whole: decided by (seed, index) alone, made of procedures alone, and consistent among themselves."""

import ast
import builtins
import io
from pathlib import Path

import pytest
import torch

import ia_bench_training
from ia_bench_training.generate import render_images
from ia_bench_training.palettes import MAX_ALBEDO, MIN_ALBEDO
from ia_bench_training.render import MAX_COVERAGE, MIN_COVERAGE
from ia_bench_training.shading import DirectLight
from ia_bench_training.shards import CHANNELS

SIZE = 24
DIRECT = DirectLight(compiled=False)
GENERATOR = (
    "cameras", "draws", "generate", "lights", "noise", "objects", "palettes", "patterns", "primitives", "render", "shading",
    "smooth", "surfaces", "textures",
)  # fmt: skip
ALLOWED = {
    "__future__", "collections.abc", "dataclasses", "functools", "typing", "math", "pathlib", "numpy", "numpy.random", "torch",
    "torch.nn.functional", "scipy.interpolate", "scipy.spatial", "skimage.measure", "ia_bench.light.latlong",
    "ia_bench.material.brdf", "ia_bench.render.embree", "ia_bench.render.gbuffer", "ia_bench.render.lattice",
    "ia_bench.render.ray_caster", "ia_bench.render.rays", "ia_bench.scenes.color", "ia_bench.scenes.scene",
    "ia_bench_training", "ia_bench_training.shards",
}  # fmt: skip


@pytest.fixture(scope="module")
def images():
    return render_images(11, 0, 12, SIZE, DIRECT)[0]


def test_an_image_is_the_same_whatever_is_rendered_beside_it(images):
    alone, _ = render_images(11, 5, 2, SIZE, DIRECT)
    across, _ = render_images(11, 7, 2, SIZE, DIRECT)
    for name in CHANNELS:
        torch.testing.assert_close(alone[name], images[name][5:7], rtol=2e-3, atol=2e-3)
        torch.testing.assert_close(across[name], images[name][7:9], rtol=2e-3, atol=2e-3)
    other, _ = render_images(12, 5, 1, SIZE, DIRECT)
    assert not torch.equal(other["albedo"], alone["albedo"][:1])


def test_the_same_call_gives_the_same_bits(images):
    again, _ = render_images(11, 0, 8, SIZE, DIRECT)
    assert all(torch.equal(again[name], images[name][:8]) for name in CHANNELS)


def test_targets_are_consistent(images):
    values = {name: image.float() for name, image in images.items()}
    coverage = values["image"][..., 3:]
    full = coverage[..., 0] == 1
    assert {name: tuple(v.shape) for name, v in values.items()} == {n: (12, SIZE, SIZE, c) for n, c in CHANNELS.items()}
    assert all(torch.isfinite(v).all() for v in values.values())
    mean_coverage = coverage.mean((1, 2, 3))
    assert mean_coverage.min() > MIN_COVERAGE
    assert mean_coverage.max() < MAX_COVERAGE
    assert all((v[(coverage == 0).expand_as(v)] == 0).all() for v in values.values())
    diffuse = values["image"][..., :3] - values["specular"]
    assert (diffuse >= -2e-3 * values["image"][..., :3]).all()  # half precision
    assert values["albedo"][full].min() >= MIN_ALBEDO - 1e-3
    assert values["albedo"][full].max() <= MAX_ALBEDO + 1e-3
    assert values["normal"].norm(dim=-1).max() <= 1.002
    assert (values["normal"][..., 2][full] > -0.02).all()  # toward the camera, up to its perspective and grazing pixels
    assert ((values["visibility"] >= 0) & (values["visibility"] <= coverage + 1e-3)).all()
    level = values["image"][..., :3].mean(-1).sum((1, 2)) / coverage.sum((1, 2, 3))
    assert ((level > 0.1) & (level < 0.9)).all()


def test_nothing_of_the_benchmark_can_get_in(monkeypatch):
    """The generator imports nothing but mathematics and parts of the renderer, opens no file, and is asked for numbers only."""
    folder = Path(ia_bench_training.__file__).parent
    for name in GENERATOR:
        tree = ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))
        modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        modules |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        own = {f"ia_bench_training.{other}" for other in GENERATOR}
        assert modules <= ALLOWED | own, f"{name} imports {modules - ALLOWED - own}"
        called = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
        assert not called & {"open", "exec", "eval", "__import__"}, name
    render_images(2, 0, 1, 8, DIRECT)  # whatever is loaded on first use

    def refuse(*arguments, **options):
        raise AssertionError(f"opened {arguments}")

    monkeypatch.setattr(builtins, "open", refuse)
    monkeypatch.setattr(io, "open", refuse)
    monkeypatch.setattr(Path, "open", refuse)
    render_images(2, 0, 1, 8, DIRECT)
