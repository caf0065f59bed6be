"""Light that turns with the camera: that of a turntable, or of a lamp that the camera carries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Round:
    """Photographs that were taken while an object turned about one axis, before it was laid down anew.

    Attributes:
        axis: Unit vector in the object's coordinates, upward in the photographs.
        point: A point on the axis, in scene units.
        circles: Height above the point along the axis, and radius, of each circle that the cameras are on; none where the axis was
            given.
    """

    axis: Vector
    point: Vector = (0.0, 0.0, 0.0)
    circles: tuple[tuple[float, float], ...] = ()

    def arms(self, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The arms of centres (V, 3), across the axis from the point, (V, 3), and their heights above it, (V,)."""
        arm, axis = centres - self.point, np.array(self.axis)
        height = arm @ axis
        return arm - height[:, None] * axis, height

    def distance(self, to_world: np.ndarray) -> np.ndarray:
        """How far (V,) cameras of the matrices (V, 3 or 4, 4) are from belonging to the round, over the radius, squared.

        The distance from the nearest circle, and the sine of the camera's roll about the axis; upside down is far.
        """
        across, height = self.arms(to_world[:, :3, 3])
        heights, radii = np.array(self.circles).reshape(-1, 2).T
        off = np.square(height[:, None] - heights) + np.square(np.linalg.norm(across, axis=1)[:, None] - radii)
        near = (off / np.square(radii)).min(1) if len(radii) else np.zeros(len(across))
        sideways, upward = (to_world[:, :3, place] @ np.array(self.axis) for place in (0, 1))
        turned: np.ndarray = near + np.square(sideways) + (upward < 0)
        return turned


@dataclass(frozen=True)
class TurningLight:
    """How a light turns about the object from view to view, told by cameras alone.

    An object on a turntable before a camera and lamps that stand still is, in its own coordinates, at rest in a light that goes
    round it with the camera. The light's map is as it stands for the first photograph; light that comes from direction d of the
    object in view v is found at R_v d in the map, with R_v = 1 for the first photograph.

    With B_v = (from the axis to the camera, across both, axis), what of the room the object's coordinates are in view v,

        R_v = B_0 B_v^T.

    Where the object was laid down anew, another axis holds from then on. Camera and lamps are taken to have stayed where they were,
    but for the camera's height and distance.

    Attributes:
        start: (3, 4), the camera-to-world matrix of the first photograph.
        rounds: About which axes the light turns as far as the camera's centre does; none where the light is fixed to the camera and
            turns with it in every way.
        residual: How far the centres of the cameras are from circles around their axes, root mean square over their mean radius;
            None where the axis was given, or where there is none.
    """

    start: tuple[tuple[float, float, float, float], ...]
    rounds: tuple[Round, ...] = ()
    residual: float | None = None

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> TurningLight:
        """What :meth:`record` has told, or did while there was one axis at most."""
        start = tuple(map(tuple, record["start"]))
        rounds = record["rounds"] if "rounds" in record else [record] if record["axis"] is not None else []
        made = [Round(tuple(one["axis"]), tuple(one["point"]), tuple(map(tuple, one.get("circles", ())))) for one in rounds]
        return cls(start, tuple(made), record["residual"])

    def record(self) -> dict[str, Any]:
        """The attributes as JSON types."""
        rounds = [{**vars(one), "circles": list(map(list, one.circles))} for one in self.rounds]
        return {"start": list(map(list, self.start)), "rounds": rounds, "residual": self.residual}

    def rounds_of(self, to_world: np.ndarray) -> np.ndarray:
        """The numbers (V,) of the rounds to which cameras of the matrices (V, 3 or 4, 4) belong: the nearest ones."""
        if len(self.rounds) < 2:
            return np.zeros(len(to_world), int)
        return np.stack([one.distance(to_world) for one in self.rounds]).argmin(0)

    def angles(self, to_world: np.ndarray) -> np.ndarray:
        """By how much (V,) radians the light has turned about its axis since the first of the cameras (V, 3 or 4, 4) of a round."""
        frames, numbers = self._frames(to_world), self.rounds_of(to_world)
        first = frames[[int((numbers == number).argmax()) for number in numbers]]
        sine, cosine = (np.einsum("vi,vi->v", frames[:, :, 0], first[:, :, place]) for place in (1, 0))
        return np.arctan2(sine, cosine)

    def rotations(self, to_world: np.ndarray) -> np.ndarray:
        """R_v of the cameras of the matrices (V, 3 or 4, 4): (V, 3, 3)."""
        start = np.array(self.start)[None]
        if not self.rounds:
            found: np.ndarray = start[0, :, :3] @ to_world[:, :3, :3].transpose(0, 2, 1)
            return found
        frames: np.ndarray = self._frames(start) @ self._frames(to_world).transpose(0, 2, 1)
        return frames

    def _frames(self, to_world: np.ndarray) -> np.ndarray:
        """B_v of the cameras of the matrices (V, 3 or 4, 4): (V, 3, 3), the directions as columns."""
        number = self.rounds_of(to_world)
        across = np.stack([one.arms(to_world[:, :3, 3])[0] for one in self.rounds])[number, np.arange(len(number))]
        axis, length = np.array([one.axis for one in self.rounds])[number], np.linalg.norm(across, axis=1, keepdims=True)
        sideways = np.cross(to_world[:, :3, 0], axis)  # for a held-out camera on the axis
        out = np.where(length > 0, across, sideways)
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        return np.stack([out, np.cross(axis, out), axis], -1)
