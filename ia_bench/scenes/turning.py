"""Light that turns with the camera: that of a turntable, or of a lamp that the camera carries."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class TurningLight:
    """How a light turns about the object from view to view, told by cameras alone.

    An object on a turntable before a camera and lamps that stand still is, in its own coordinates, at rest in a light that goes
    round it with the camera. The light's map is as it stands for the first photograph; light that comes from direction d of the
    object in view v is found at R_v d in the map, with R_v = 1 for the first photograph.

    Attributes:
        start: (3, 4), the camera-to-world matrix of the first photograph.
        axis: Unit vector, about which the light turns as far as the camera's centre does; None where the light is fixed to the
            camera and turns with it in every way.
        point: A point on the axis, in scene units.
        residual: How far the centres of the cameras are from circles around the axis, root mean square over their mean radius;
            None where the axis was given, or where there is none.
    """

    start: tuple[tuple[float, float, float, float], ...]
    axis: Vector | None = None
    point: Vector = (0.0, 0.0, 0.0)
    residual: float | None = None

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> TurningLight:
        """What :meth:`record` has told."""
        axis = record["axis"]
        start = tuple(map(tuple, record["start"]))
        return cls(start, None if axis is None else tuple(axis), tuple(record["point"]), record["residual"])

    def record(self) -> dict[str, Any]:
        """The attributes as JSON types."""
        return {key: list(map(list, value)) if key == "start" else value for key, value in vars(self).items()}

    def angles(self, to_world: np.ndarray) -> np.ndarray:
        """By how much the light has turned about the axis, in cameras of the matrices (V, 3 or 4, 4): (V,) radians."""
        axis, arms = np.array(self.axis), np.concatenate([np.array(self.start)[None], to_world[:, :3]])[..., 3] - self.point
        first = arms[0] - (arms[0] @ axis) * axis
        return np.arctan2(arms[1:] @ np.cross(axis, first), arms[1:] @ first)

    def rotations(self, to_world: np.ndarray) -> np.ndarray:
        """R_v of the cameras of the matrices (V, 3 or 4, 4): (V, 3, 3)."""
        if self.axis is None:
            found: np.ndarray = np.array(self.start)[:, :3] @ to_world[:, :3, :3].transpose(0, 2, 1)
            return found
        return np.stack([rotation_about(np.array(self.axis), -angle) for angle in self.angles(to_world)])


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation (3, 3) about a unit ``axis`` by ``angle`` radians (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: np.ndarray = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return turned
