"""How the prior is asked, what of its answers is refused, and what is kept of them between runs."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from ia_bench.common.errors import InputError
from ia_bench.methods.asking.sample_cache import SampleCache, StoredSample, content_key
from ia_bench.methods.asking.sampling import PriorSampler
from ia_bench.methods.asking.views import evenly_spread, restrict
from ia_bench.methods.contract import Problem
from ia_bench.methods.two_stage.settings import SupervisionSettings
from ia_bench.render.renderer import texture_images
from ia_bench.scenes.scene import Scene


class Spy:
    """Returns half of the image and twice the image, plus its seed's noise; remembers how it was asked."""

    provides = frozenset({"albedo", "specular"})
    encoding: Mapping[str, str] = {"albedo": "srgb", "specular": "srgb"}
    stochastic = True
    guidable = True
    sees_truth = False
    network_calls = 0

    def __init__(self, **answers: object) -> None:
        self.answers = answers
        self.asked: list[dict] = []

    def sample(self, images: Tensor, masks: Tensor, **rest: object) -> dict:
        self.asked.append({"images": images, "masks": masks, **rest})
        self.network_calls += 3
        samples = {"albedo": 0.5 * images, "specular": 2 * images, **self.answers}
        return {name: value for name, value in samples.items() if value is not None}


class Kept(Spy):
    """May be kept between runs."""

    def __init__(self, fingerprint: str = "kept, version 1", **answers: object) -> None:
        super().__init__(**answers)
        self.fingerprint = fingerprint


class Counting(Kept):
    """Counts on its own."""

    @property
    def counters(self) -> Mapping[str, int]:
        return {"cut": 2 * self.network_calls}


class Reader(Spy):
    """Wants to see the geometry."""

    reads_geometry = True

    def give_geometry(self, normals: Tensor, visibility: Tensor) -> None:
        self.asked.append({"normals": normals, "visibility": visibility})

    def distill(self, images: Tensor, masks: Tensor, renders: Mapping[str, Tensor], *, seed: int) -> dict[str, Tensor]:
        self.asked.append({"images": images, "seed": seed})
        return dict(renders)


def sampler(problem: Problem, prior: object, seed: int = 7, **settings: object) -> PriorSampler:
    changed = replace(problem, supervision=SupervisionSettings(**settings))  # type: ignore[arg-type]
    return PriorSampler(changed, prior, seed)  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("IA_BENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


# ---- what it is asked, and what of the answer is refused ------------------------------------------------------------


def test_prior_is_shown_the_training_images_alone(problem: Problem) -> None:
    spy = Spy()
    sample = sampler(problem, spy).draw(None)
    assert len(spy.asked) == 1
    asked = spy.asked[0]
    assert (asked["seed"], asked["guidance"]) == (7, None)
    np.testing.assert_array_equal(asked["images"], np.stack([v.image for v in problem.scene.train]))
    np.testing.assert_array_equal(asked["masks"], np.stack([v.mask for v in problem.scene.train]))
    assert torch.equal(sample["albedo"], 0.5 * asked["images"])


def test_guidance_is_handed_through(problem: Problem) -> None:
    spy, guide = Spy(), {"albedo": torch.rand(16, 32, 32, 3)}
    sampler(problem, spy).draw(guide)
    assert torch.equal(spy.asked[0]["guidance"]["albedo"], guide["albedo"])


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"specular": None}, r"provides \['albedo', 'specular'\] but sampled \['albedo'\]"),
        ({"normal": torch.zeros(1)}, r"but sampled \['albedo', 'normal', 'specular'\]"),
        ({"albedo": torch.zeros(16, 32, 32, 1)}, r"albedo has shape \(16, 32, 32, 1\), expected \(16, 32, 32, 3\)"),
        ({"specular": torch.full((16, 32, 32, 3), torch.nan)}, "specular has NaN or Inf in 49152 values"),
    ],
)
def test_broken_samples_are_refused(problem: Problem, answers: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sampler(problem, Spy(**answers)).draw(None)


def test_distillation_needs_a_distiller(problem: Problem) -> None:
    with pytest.raises(InputError, match=r"prior\.supervision\.kind=sds: expected a prior with .*distill.*found Spy"):
        sampler(problem, Spy(), kind="sds")
    sampler(problem, Reader(), kind="sds")


# ---- some of the views ----------------------------------------------------------------------------------------------


def test_few_views_are_spread_evenly(scene: Scene) -> None:
    """Farther apart than any of many random choices; in order; the whole list for "all" or for too many."""
    middle = 0.5 * (scene.mesh.vertices.min(0) + scene.mesh.vertices.max(0))
    directions = np.stack([view.camera.to_world[:3, 3] for view in scene.train]) - middle
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def closest(views: tuple[int, ...] | np.ndarray) -> float:
        cosines = directions[list(views)] @ directions[list(views)].T
        return float(np.arccos((cosines - 2 * np.eye(len(views))).max()))

    chosen = evenly_spread(scene, 4)
    assert len(set(chosen)) == 4
    assert list(chosen) == sorted(chosen)
    random = np.random.default_rng(0)
    others = [closest(random.choice(len(scene.train), 4, replace=False)) for _ in range(300)]
    assert closest(chosen) > np.quantile(others, 0.9)
    everything = tuple(range(len(scene.train)))
    assert evenly_spread(scene, "all") == evenly_spread(scene, 16) == evenly_spread(scene, 99) == everything


def test_only_the_chosen_views_are_asked_about(problem: Problem) -> None:
    spy = Spy()
    asking = sampler(problem, spy, views=3)
    asking.draw(None)
    expected = np.stack([problem.scene.train[view].image for view in asking.views])
    assert len(expected) == 3
    np.testing.assert_array_equal(spy.asked[0]["images"], expected)


def test_restricted_gbuffer_sees_the_same(problem: Problem) -> None:
    texture = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0))
    whole = texture_images(problem.renderer.surface, problem.gbuffer, texture)
    part, rows = restrict(problem.gbuffer, (2, 5, 11))
    assert torch.equal(texture_images(problem.renderer.surface, part, texture), whole[[2, 5, 11]])
    assert torch.equal(part.origin, problem.gbuffer.origin[[2, 5, 11]])
    assert torch.equal(problem.pixels_of(whole)[rows], whole[[2, 5, 11]].reshape(-1, 3)[part.pixel])
    same, every = restrict(problem.gbuffer, tuple(range(16)))
    assert torch.equal(same.pixel, problem.gbuffer.pixel)
    assert torch.equal(every, torch.arange(len(problem.gbuffer.pixel)))


def test_geometry_comes_before_every_question_about_other_views(problem: Problem) -> None:
    reader = Reader()
    asking = sampler(problem, reader, views=3)
    asking.draw(None)
    asking.draw(None)
    asking.distill({"albedo": torch.zeros(2, 32, 32, 3)}, (0, 4), seed=1)
    asking.draw(None)
    given = [len(asked.get("normals", ())) for asked in reader.asked]
    assert given == [3, 0, 0, 2, 0, 3, 0]


# ---- what is kept ---------------------------------------------------------------------------------------------------


def test_samples_are_kept_with_what_they_cost(problem: Problem, cache: Path) -> None:
    first, second = sampler(problem, Kept()), sampler(problem, again := Kept())
    drawn, kept = first.draw(None), second.draw(None)
    assert again.asked == []
    assert all(torch.equal(drawn[name], kept[name]) for name in drawn)
    assert first.counters == {"network_calls": 3, "prior_cached": 0}
    assert second.counters == {"network_calls": 3, "prior_cached": 1}
    assert first.kept_seconds == 0
    assert second.kept_seconds > 0
    assert len(list(cache.glob("samples-*.safetensors"))) == 1
    assert len(list(cache.iterdir())) == 1  # nothing half-written is left


def test_what_a_prior_counts_is_kept_and_starts_at_none(problem: Problem) -> None:
    used = Counting()
    used.network_calls = 100  # by somebody else
    first, second = sampler(problem, used), sampler(problem, Counting())
    assert first.counters == {"prior_cached": 0, "network_calls": 0, "cut": 0}
    first.draw(None)
    second.draw(None)
    assert first.counters == {"prior_cached": 0, "network_calls": 3, "cut": 6}
    assert second.counters == {"prior_cached": 1, "network_calls": 3, "cut": 6}


@pytest.mark.parametrize("change", ["fingerprint", "seed", "views", "guided", "image", "off", "no fingerprint", "truth"])
def test_samples_of_anything_else_are_drawn(problem: Problem, change: str) -> None:
    sampler(problem, Kept()).draw(None)
    prior: Spy = Kept("another") if change == "fingerprint" else Spy() if change == "no fingerprint" else Kept()
    prior.sees_truth = change == "truth"
    settings: dict[str, object] = {"views": {"views": 5}, "off": {"cache": False}}.get(change, {})
    if change == "image":
        views = problem.scene.train
        brighter = replace(views[3], image=views[3].image * np.float32(1.001))
        problem = replace(problem, scene=replace(problem.scene, train=(*views[:3], brighter, *views[4:])))
    asking = sampler(problem, prior, 8 if change == "seed" else 7, **settings)
    asking.draw({"albedo": torch.zeros(16, 32, 32, 3)} if change == "guided" else None)
    assert len(prior.asked) == 1
    assert asking.counters == {"network_calls": 3, "prior_cached": 0}


def test_geometry_decides_too(problem: Problem) -> None:
    class Both(Kept, Reader):
        pass

    sampler(problem, Both()).draw(None)
    asking = sampler(problem, Both())
    asking.draw(None)
    assert asking.counters["prior_cached"] == 1
    mesh = problem.scene.mesh
    for changed in (replace(mesh, normals=-mesh.normals), replace(mesh, uv=1 - mesh.uv)):  # baked shadows are looked up by UV
        asking = sampler(replace(problem, scene=replace(problem.scene, mesh=changed)), Both())
        asking.draw(None)
        assert asking.counters["prior_cached"] == 0


def test_cache_survives_what_happens_to_files(tmp_path: Path) -> None:
    stored = StoredSample({"albedo": torch.rand(2, 5, 7, 3)}, 1.5, {"network_calls": 40, "cut": 3})
    cache = SampleCache(tmp_path)
    key = content_key("a", torch.zeros(3))
    assert cache.load(key) is None
    cache.store(key, stored)
    found = cache.load(key)
    assert found is not None
    assert torch.equal(found.sample["albedo"], stored.sample["albedo"])
    assert (found.seconds, found.counters) == (1.5, stored.counters)
    path = next(tmp_path.iterdir())
    path.write_bytes(path.read_bytes()[:100])
    assert cache.load(key) is None
    (tmp_path / "file").write_text("")
    SampleCache(tmp_path / "file").store(key, stored)  # no folder can be made there: nothing is kept, nothing raised


def test_cache_forgets_what_was_used_longest_ago(tmp_path: Path) -> None:
    import os

    stored = StoredSample({"albedo": torch.zeros(100)}, 0.0, {})  # 400 bytes and a header
    cache = SampleCache(tmp_path, limit=1500)
    keys = [content_key(str(number)) for number in range(3)]
    for age, key in enumerate(keys[:2]):
        cache.store(key, stored)
        os.utime(next(tmp_path.glob(f"*{key[:32]}*")), (1000 + age, 1000 + age))
    assert cache.load(keys[0]) is not None  # used just now, so the other one is the older
    cache.store(keys[2], stored)
    assert [cache.load(key) is not None for key in keys] == [True, False, True]


def test_cache_removes_what_a_killed_writer_left(tmp_path: Path) -> None:
    old, young = (tmp_path / f".samples-{name}.1.safetensors" for name in ("old", "young"))
    for path in (old, young):
        path.write_bytes(b"half")
    os.utime(old, (1000, 1000))
    SampleCache(tmp_path).store(content_key("a"), StoredSample({"albedo": torch.zeros(3)}, 0.0, {}))
    assert (old.exists(), young.exists()) == (False, True)


def test_another_number_of_threads_is_another_draw(problem: Problem, cache: Path) -> None:
    """The last bits of a sample depend on it, and the same configuration must give the same numbers."""
    threads = torch.get_num_threads()
    sampler(problem, Kept()).draw(None)
    try:
        torch.set_num_threads(threads + 1)
        other = sampler(problem, Kept())
        other.draw(None)
    finally:
        torch.set_num_threads(threads)
    assert other.counters["prior_cached"] == 0


def test_keys_are_delimited() -> None:
    assert content_key("ab", "c") != content_key("a", "bc")
    assert content_key(torch.zeros(2, 3)) != content_key(torch.zeros(3, 2))
