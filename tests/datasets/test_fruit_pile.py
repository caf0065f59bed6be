"""Where the fruit lies in its bowl, against brute force over points of the spheres."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.path import Path as Polygon
from recipe_modules import latlong, load

pile = load("objects.fruit_pile")
SPHERE = latlong.texel_directions(24).reshape(-1, 3)


@pytest.fixture(scope="module")
def settled() -> list[np.ndarray]:
    """Spheres (k, 4) of every piece of fruit in the world, then of every grape."""
    places, grapes = pile.settle()
    lumps = []
    for name, lump in pile.FRUIT.items():
        centres = places[name] + lump.size * lump.spheres[:, :3] @ pile.turned_to(lump.axis).T
        lumps.append(np.column_stack([centres, lump.size * lump.spheres[:, 3]]))
    return [*lumps, *grapes[:, None]]


def gap(a: np.ndarray, b: np.ndarray) -> float:
    """Distance between two lumps, negative where they overlap."""
    return min(float(np.linalg.norm(p[:3] - q[:3]) - p[3] - q[3]) for p in a for q in b)


def surface(lump: np.ndarray) -> np.ndarray:
    """Points on a lump's spheres."""
    return (lump[:, None, :3] + lump[:, None, 3:] * SPHERE).reshape(-1, 3)


def test_fruit_touches_and_does_not_overlap(settled: list[np.ndarray]) -> None:
    gaps = {(i, j): gap(settled[i], settled[j]) for i, j in combinations(range(len(settled)), 2)}
    assert min(gaps.values()) > -1e-3
    touching = {i for pair, distance in gaps.items() if distance < 2e-3 for i in pair}
    assert touching >= set(range(len(pile.FRUIT)))
    assert len(touching) > 0.9 * len(settled)


def test_fruit_lies_outside_the_wood_and_above_the_table(settled: list[np.ndarray]) -> None:
    """The bowl's section as a polygon: none of the spheres' points is inside it, made thinner by two thousandths."""
    for lump in settled:
        points = surface(lump)
        section = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2] - pile.TABLE], axis=1)
        assert section[:, 1].min() > -1e-6
        inside = Polygon(pile.PROFILE).contains_points(section)
        edge = np.concatenate(
            [a + np.linspace(0, 1, 60)[:, None] * (b - a) for a, b in zip(pile.PROFILE, pile.PROFILE[1:], strict=False)]
        )
        depth = np.linalg.norm(section[inside][:, None] - edge, axis=-1).min(axis=1)
        assert depth.max(initial=0.0) < 4e-3


def test_everything_keeps_within_the_unit_sphere(settled: list[np.ndarray]) -> None:
    assert max(np.linalg.norm(surface(lump), axis=1).max() for lump in settled) < 1.0
