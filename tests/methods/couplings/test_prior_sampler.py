"""How the prior is asked, what is kept of its answers between runs, and what they say of each pixel."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_fit import altered, oracle
from torch import Tensor

from ia_bench.methods.contract import Monitor, PixelSamples, Problem
from ia_bench.methods.couplings.sampler import PriorSampler, pixel_samples
from ia_bench.methods.photographs import restrict, stacked, view_geometry
from ia_bench.methods.two_stage.prior import PriorLoss
from ia_bench.priors.contract import Observations, PriorInfo, Samples
from ia_bench.priors.validation import beyond_a_material
from ia_bench.render.renderer import Renderer, texture_images
from ia_bench.scenes.scene import Scene

pytestmark = pytest.mark.usefixtures("no_cache")


class Spy:
    """Returns half of the image and twice the image, plus its seed's noise; remembers how it was asked."""

    info = PriorInfo(frozenset({"albedo", "specular"}), stochastic=True, guidable=True)

    def __init__(self, fingerprint: str | None = None, cost: int = 3) -> None:
        self.asked: list[tuple[Observations, int, Mapping[str, Tensor] | None]] = []
        self.cost = {"network_calls": cost, "cut": 2 * cost}
        if fingerprint is not None:  # its samples may be kept between runs
            self.fingerprint = fingerprint

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        self.asked.append((observations, seed, guidance))
        images, ceiling = observations.images, torch.arange(1.0, len(observations.images) + 1)
        return Samples({"albedo": 0.5 * images, "specular": 2 * images}, {"specular": ceiling}, self.cost)


def kept(version: int = 1) -> Spy:
    return Spy(f"kept, version {version}")


class Reader(Spy):
    """Wants to see the geometry, and can be distilled."""

    info = replace(Spy.info, wants=frozenset({"normals", "visibility"}))

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        self.asked.append((observations, seed, None))
        return Samples(dict(renders))


def kept_reader() -> Reader:
    return Reader("reader")


def sampler(problem: Problem, prior: object, seed: int = 7, notes: list[str] | None = None, **parts: object) -> PriorSampler:
    return PriorSampler(altered(problem, **parts), prior, seed, [].append if notes is None else notes.append)  # type: ignore[arg-type]


# ---- what it is asked -----------------------------------------------------------------------------------------------
def test_prior_is_shown_the_training_images_alone(problem: Problem) -> None:
    spy = Spy()
    samples = sampler(problem, spy).draw(None)
    ((shown, seed, guidance),) = spy.asked
    assert (seed, guidance) == (7, None)
    assert shown.views == tuple(range(16))
    assert (shown.normals, shown.visibility, shown.truth) == (None, None, None)
    np.testing.assert_array_equal(shown.images, np.stack([v.image for v in problem.scene.train]))
    np.testing.assert_array_equal(shown.masks, np.stack([v.mask for v in problem.scene.train]))
    assert torch.equal(samples.values["albedo"], 0.5 * shown.images)


def test_absurd_values_are_counted_and_told_once(problem: Problem) -> None:
    notes: list[str] = []
    spy = Spy()
    asking = sampler(problem, spy, notes=notes)
    asking.draw(None)
    assert asking.counters["prior_absurd_values"] == 0
    largest = 0.5 * max(float(view.image.max()) for view in problem.scene.train)
    assert notes == [f"prior Spy proposes an albedo up to {largest:.3g}, expected 0 to 1; it is used, and ia-bench check says more"]
    notes.clear()
    views = problem.scene.train
    spoiled = views[0].image.copy()
    spoiled[0, :5, 0], spoiled[0, :2, 1] = -1, 1e7  # in albedo, half of it, and in specular, twice of it
    changed = altered(problem, scene=replace(problem.scene, train=(replace(views[0], image=spoiled), *views[1:])))
    asking = sampler(changed, spy, notes=notes)
    asking.draw(None)
    asking.draw({"albedo": torch.zeros(16, 32, 32, 3)})
    assert asking.counters["prior_absurd_values"] == 2 * 2 * 7
    assert [note for note in notes if "proposes" not in note] == [
        "prior Spy: 14 of its values are negative or above 1e+06; they are used"
    ]
    assert len(notes) == 2  # of a sampler each thing is said once


def test_an_albedo_outside_of_the_masks_is_told() -> None:
    masks, albedo = torch.zeros(2, 4, 4), torch.zeros(2, 4, 4, 3)
    masks[:, 1:3], albedo[:, 1:3] = 0.5, 0.9
    assert beyond_a_material(Samples({"albedo": albedo}), masks) is None
    albedo[0, 0, :2, 1] = 0.1
    assert beyond_a_material(Samples({"albedo": albedo}), masks) == "an albedo in 2 pixels outside of the masks, expected 0 there"
    assert beyond_a_material(Samples({"specular": 9 * torch.ones(2, 4, 4, 3)}), masks) is None


# ---- some of the views ----------------------------------------------------------------------------------------------
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


def test_geometry_is_that_of_the_views_asked_about(problem: Problem) -> None:
    reader = Reader()
    asking = sampler(problem, reader, prior_views=3)
    asking.draw(None)
    asking.distill({name: torch.zeros(2, 32, 32, 3) for name in ("albedo", "specular")}, (0, 4), seed=1)
    asking.draw(None)
    for shown, *_ in reader.asked:
        normals, visibility = view_geometry(problem, shown.views)
        assert torch.equal(shown.normals, normals)
        assert torch.equal(shown.visibility, visibility)
    assert [shown.views for shown, *_ in reader.asked] == [asking._problem.asked_views, (0, 4), asking._problem.asked_views]


def test_rays_of_what_is_shown_again_after_an_interruption_are_counted_once(problem: Problem) -> None:
    asked, generator = altered(problem, prior=Reader(), prior_views=3), torch.Generator()
    before, resumed = (PriorLoss(asked, 7, Monitor.silent()) for _ in range(2))
    before.draw(None, generator)
    resumed.load_state_dict(before.state_dict())
    counts = asked.costs.counts()
    resumed.draw(None, generator)
    assert asked.costs.counts() == counts
    resumed.sampler.distill({name: torch.zeros(2, 32, 32, 3) for name in ("albedo", "specular")}, (0, 4), seed=1)
    assert asked.costs.counts()["rays"] > counts["rays"], "of other views they are new"


# ---- what is kept ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("usual", [kept, kept_reader])
def test_samples_are_kept_with_what_they_cost(problem: Problem, no_cache: Path, usual: Callable[[], Spy]) -> None:
    first, second = sampler(problem, usual()), sampler(problem, again := usual())
    drawn, found = first.draw(None), second.draw(None)
    assert again.asked == []
    for part in ("values", "ceilings"):
        mine, theirs = getattr(drawn, part), getattr(found, part)
        assert set(mine) == set(theirs)
        assert all(torch.equal(mine[name], theirs[name]) for name in mine)
    counted = {"network_calls": 3, "cut": 6, "prior_absurd_values": 0}
    assert first.counters == {"prior_cached": 0, **counted}
    assert second.counters == {"prior_cached": 1, **counted}
    assert first.kept_seconds == 0
    assert second.kept_seconds > 0
    assert len(list(no_cache.iterdir())) == 1  # nothing half-written is left


CHANGES = ["fingerprint", "seed", "views", "guided", "image", "off", "no fingerprint", "truth", "shadows", "threads", "names"]


@pytest.mark.parametrize("change", CHANGES)
def test_samples_of_anything_else_are_drawn(problem: Problem, change: str) -> None:
    """The last bits of a sample depend on the number of threads, and the same configuration must give the same numbers."""
    usual, threads = kept_reader if change == "shadows" else kept, torch.get_num_threads()
    sampler(problem, usual()).draw(None)
    prior = kept(2) if change == "fingerprint" else Spy() if change == "no fingerprint" else usual()
    prior.info = replace(prior.info, sees_truth=change == "truth")
    settings: dict[str, object] = {"views": {"prior_views": 5}, "off": {"keep_samples": False}}.get(change, {})
    if change == "image":
        views = problem.scene.train
        brighter = replace(views[3], image=views[3].image * np.float32(1.001))
        problem = altered(problem, scene=replace(problem.scene, train=(*views[:3], brighter, *views[4:])))
    if change == "names":
        renamed = tuple(replace(view, name=f"{view.name}b") for view in problem.scene.train)
        problem = altered(problem, scene=replace(problem.scene, train=renamed))
    if change == "shadows":
        problem = altered(problem, renderer=Renderer(problem.renderer.surface, None))
    asking = sampler(problem, prior, 8 if change == "seed" else 7, **settings)
    try:
        torch.set_num_threads(threads + (change == "threads"))
        asking.draw({"albedo": torch.zeros(16, 32, 32, 3)} if change == "guided" else None)
    finally:
        torch.set_num_threads(threads)
    assert len(prior.asked) == 1
    assert (asking.counters["network_calls"], asking.counters["prior_cached"]) == (3, 0)


ALL = tuple(range(16))


def targets_of(problem: Problem, sample: Mapping[str, Tensor], asked: tuple[int, ...] = ALL) -> PixelSamples:
    return pixel_samples(problem, Samples(sample), asked)


def oracle_sample(scene: Scene, **dials: float) -> Mapping[str, Tensor]:
    shown = Observations(stacked(scene.train, "image"), stacked(scene.train, "mask"), ALL)
    return oracle(scene, **dials).sample(shown, seed=0).values


def test_targets_are_the_sample(problem: Problem, scene: Scene) -> None:
    sample = oracle_sample(scene, noise=0.1)
    targets = targets_of(problem, sample)
    for name in ("albedo", "specular"):
        assert torch.equal(targets.values[name], problem.pixels_of(sample[name]))
    assert bool((targets.weight == 1).all())


def test_few_views_keep_the_loss_at_its_weight(problem: Problem, scene: Scene) -> None:
    exact = oracle_sample(scene)
    views = (1, 6, 9)
    targets = targets_of(problem, {name: value[list(views)] for name, value in exact.items()}, views)
    asked = torch.isin(problem.gbuffer.pixel // (32 * 32), torch.tensor(views))
    assert float(targets.weight.mean()) == pytest.approx(1, rel=1e-5)
    assert bool(((targets.weight[:, 0] > 0) == asked).all())
    for name in ("albedo", "specular"):
        assert torch.equal(targets.values[name][asked], problem.pixels_of(exact[name])[asked])
        assert bool((targets.values[name][~asked] == 0).all())


def test_pixels_near_the_ceiling_are_marked(problem: Problem, scene: Scene) -> None:
    """Of the views asked only, each by its own ceiling; without one nothing is marked."""
    asked = (2, 5)
    shape = (2, *problem.gbuffer.shape[1:], 3)
    specular = torch.full(shape, 0.5)
    specular[0, ::2] = 0.9
    drawn = {"albedo": torch.full(shape, 0.5), "specular": specular}
    targets = pixel_samples(problem, Samples(drawn, {"specular": torch.tensor([1.0, 0.6])}), asked)
    height, width = shape[1:3]
    view, row = problem.gbuffer.pixel // (height * width), problem.gbuffer.pixel // width % height
    expected = (view == 5) | ((view == 2) & (row % 2 == 0))
    assert torch.equal(targets.at_least["specular"][:, 0], expected)
    assert "albedo" not in targets.at_least
    assert not targets_of(problem, drawn, asked).at_least
