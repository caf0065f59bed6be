"""Matrices of cameras as others write them, and what brings them into the convention of :class:`ia_bench.scenes.scene.Camera`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

OPENCV_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns OpenCV's axes (+z forward, +y down) into OpenGL's (-z forward, +y up), and back."""

CONVENTIONS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "OpenCV's (+z forward, +y down)": lambda matrix: matrix @ OPENCV_AXES,
    "world-to-camera": np.linalg.inv,
    "OpenCV's world-to-camera": lambda matrix: np.linalg.inv(matrix) @ OPENCV_AXES,
}
"""What a matrix (4, 4) may be in place of OpenGL's camera-to-world -> what makes that of it."""
