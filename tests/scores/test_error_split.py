"""Where the albedo's error sits: errors that are made to be of one kind, in pictures of a square 96 pixels wide."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from made_up import Ball
from shapes import camera_at, plate, together
from test_scorer import SMALL, ball_scene

from ia_bench.scenes.color import linear_to_srgb, srgb_to_linear
from ia_bench.scenes.scene import View
from ia_bench.scores.comparison import Pair, as_it_is, of_object
from ia_bench.scores.error_split import VisibleSurface, split
from ia_bench.scores.metrics import ERROR_PARTS, MEASURED, NoScoredPixel, Undefined, squared_error
from ia_bench.scores.protocol import Encoding, Protocol
from ia_bench.scores.scorer import Scorer

SIDE = 96
CPU = torch.device("cpu")
Y, X = np.mgrid[:SIDE, :SIDE] / SIDE
RANDOM = np.random.default_rng(0)
TRUE = srgb_to_linear(0.4 + 0.2 * RANDOM.random((SIDE, SIDE, 3)))


def flat(hidden: np.ndarray | None = None, views: int = 1, height: float = 0.0, facing: float = 1.0) -> VisibleSurface:
    """A square, seen as it is; ``hidden`` (SIDE, SIDE) bool is what no photograph shows."""
    position = np.stack([X, Y, np.full_like(X, height)], -1).reshape(-1, 3)
    seen = np.ones(SIDE**2, bool) if hidden is None else ~hidden.reshape(-1)
    entry = np.arange(SIDE**2).reshape(SIDE, SIDE)
    return VisibleSurface(position, np.tile([0.0, 0.0, facing], (SIDE**2, 1)), seen, (entry,) * views)


def pair_of(predicted: np.ndarray, mask: np.ndarray | None = None) -> Pair:
    every = np.ones((SIDE, SIDE), bool)
    return Pair(predicted, TRUE, every if mask is None else mask, every, (np.ones((SIDE, SIDE)),) * 2)


def shares(predicted: np.ndarray, shown: VisibleSurface | None = None) -> dict[str, float]:
    """The parts of the error over their sum, which has to be the error."""
    view = pair_of(predicted)
    (found,) = split([view], shown or flat(), Protocol())
    total = sum(found.values())
    assert total == pytest.approx(squared_error(of_object(view, Protocol(), "srgb")), rel=1e-12)
    return {name: part / total for name, part in found.items()}


def test_the_parts_of_any_error_add_up_to_it_in_every_view() -> None:
    masks = [np.hypot(X - 0.5, Y - 0.5) < radius for radius in (0.3, 0.45)]
    views = [pair_of(RANDOM.random((SIDE, SIDE, 3)), mask) for mask in masks]
    hidden = RANDOM.random((SIDE, SIDE)) < 0.3
    for view, found in zip(views, split(views, flat(hidden, views=2), Protocol()), strict=True):
        assert set(found) == set(ERROR_PARTS)
        assert sum(found.values()) == pytest.approx(squared_error(of_object(view, Protocol(), "srgb")), rel=1e-12)
        assert all(value > 0 for value in found.values())


def encoded_error(error: np.ndarray) -> np.ndarray:
    return srgb_to_linear(linear_to_srgb(TRUE) + error)


@pytest.mark.parametrize(("times", "encoding"), [(1.0, "linear"), (0.01, "srgb")], ids=["linear", "toe of the sRGB curve"])
@pytest.mark.parametrize("brighter", [1.2, 0.7])
def test_brightness_is_a_level_where_encoding_is_no_power_of_values(times: float, encoding: Encoding, brighter: float) -> None:
    view = replace(pair_of(brighter * times * TRUE), true=times * TRUE)
    (found,) = split([view], flat(), Protocol(albedo_encoding=encoding))
    assert found["level"] == pytest.approx(sum(found.values()), rel=1e-4)
    assert found["low"] == pytest.approx(0, abs=1e-5 * found["level"])


SHADED = 0.1 * np.cos(np.pi * X)[..., None]  # from left to right


@pytest.mark.parametrize(
    ("predicted", "kind", "least"),
    [
        (TRUE * 0.7, "level", 1 - 1e-6),
        (TRUE * np.array([1.3, 1.0, 0.8]), "level", 1 - 1e-6),
        (encoded_error(0.1 * RANDOM.standard_normal((SIDE, SIDE, 3))), "high", 0.97),
        (encoded_error(SHADED), "low", 0.95),
    ],
    ids=["darker", "a colour cast", "noise of texels", "smooth shading"],
)
def test_an_error_of_one_kind_is_found_in_one_part(predicted: np.ndarray, kind: str, least: float) -> None:
    assert shares(predicted)[kind] > least


def test_what_no_photograph_shows_is_apart_and_has_no_say_in_the_factor() -> None:
    hidden = (X > 0.5) & (Y < 0.4)
    found = shares(np.where(hidden[..., None], 0.9, TRUE), flat(hidden))
    assert found == pytest.approx({"level": 0.0, "low": 0.0, "high": 0.0, "unseen": 1.0}, abs=1e-10)


def test_both_sides_of_something_thin_are_smoothed_apart() -> None:
    """An error of one sign above and of the other below is a smooth one on either side, and nothing where both are mixed."""
    above, below = flat(), flat(height=1e-3, facing=-1.0)
    entry = (above.entry[0], below.entry[0] + SIDE**2)
    both = VisibleSurface(*(np.concatenate(parts) for parts in zip(above[:3], below[:3], strict=True)), entry)
    views = [pair_of(encoded_error(np.array(sign * 0.05))) for sign in (1, -1)]
    for found in split(views, both, Protocol()):
        assert found["low"] > 0.95 * sum(found.values())


@pytest.mark.parametrize(
    ("change", "expected"),
    [(lambda p: np.where(X[..., None] > 2, p, np.nan), Undefined), (lambda p: p, NoScoredPixel)],
    ids=["not finite", "no scored pixel"],
)
def test_what_cannot_be_split_says_why(change: Callable[[np.ndarray], np.ndarray], expected: type[Exception]) -> None:
    mask = np.full((SIDE, SIDE), expected is not NoScoredPixel)
    with pytest.raises(expected):
        split([pair_of(change(TRUE), mask)], flat(), Protocol())


def test_black_has_no_factor_and_a_view_without_a_pixel_no_parts() -> None:
    views = [pair_of(np.zeros_like(TRUE)), pair_of(TRUE, np.zeros((SIDE, SIDE), bool))]
    black, empty = split(views, flat(views=2), Protocol())
    assert black["level"] == 0
    with pytest.raises(NoScoredPixel):
        as_it_is(replace(views[1], parts=empty), Protocol())


def test_a_picture_so_black_that_no_factor_makes_its_mean_right_has_none() -> None:
    holed = np.where(((X * SIDE).astype(int) % 3 == 0)[..., None], TRUE, 0.0)  # white in a third of the pixels were too dark
    (found,) = split([pair_of(holed)], flat(), Protocol())
    assert found["level"] == 0
    spotted = np.where(((X * SIDE).astype(int) % 10 == 0)[..., None], 0.0, TRUE)  # a tenth of the pixels are black
    (found,) = split([pair_of(spotted)], flat(), Protocol())
    assert found["level"] != 0


def test_photographs_from_above_do_not_show_the_underside_nor_what_is_covered() -> None:
    mesh = together(plate(1.0), plate(0.5, height=0.5))
    above, slant = camera_at((0.01, 0.0, 4.0), pixels=40), camera_at((2.5, 0.0, 1.2), pixels=40)
    black = np.zeros((40, 40, 3), np.float32)
    photograph = View("above", above, black, black[..., 0])
    shown = VisibleSurface.of(mesh, [above, slant, camera_at((2.5, 0.0, -1.2), pixels=40)], [photograph], CPU)
    entries = [entry[entry >= 0] for entry in shown.entry]
    assert shown.seen[entries[0]].all()
    assert not shown.seen[entries[2]].any()
    covered = (shown.position[:, 2] < 0.1) & (np.abs(shown.position[:, :2]).max(1) < 0.45)
    on_slant = entries[1][covered[entries[1]]]
    assert len(on_slant)
    assert not shown.seen[on_slant].any()
    assert not VisibleSurface.of(mesh, [above], [], CPU).seen.any()
    half = np.broadcast_to(np.arange(40) < 20, (40, 40))  # the rest of the picture is beyond the photograph
    cropped = VisibleSurface.of(mesh, [above], [replace(photograph, valid=half)], CPU)
    assert cropped.seen[cropped.entry[0][:, :19][cropped.entry[0][:, :19] >= 0]].all()
    assert not cropped.seen[cropped.entry[0][:, 21:][cropped.entry[0][:, 21:] >= 0]].any()


@pytest.mark.usefixtures("mean_square_as_lpips")
def test_scores_have_the_parts_as_a_group_of_metrics() -> None:
    scene = ball_scene(lights=())
    scores = Scorer(scene, SMALL, CPU).full(Ball(albedo=(0.6, 0.3, 0.2)))
    found = scores.metrics["albedo_error"]
    assert list(found) == ["total", *ERROR_PARTS] == [m.name for m in MEASURED if m.group == "Where the error sits"]
    assert found["total"] == pytest.approx(sum(found[name] for name in ERROR_PARTS))
    for image, psnr in zip(scores.per_image["albedo_error"]["total"], scores.per_image["albedo"]["psnr"], strict=True):
        assert image == pytest.approx(1000 * 10 ** (-psnr / 10))
