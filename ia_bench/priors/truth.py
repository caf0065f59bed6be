"""The ground truth of the training views, as the priors that see it keep it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ia_bench.common.errors import InputError
from ia_bench.scenes.scene import View


class RevealedTruth:
    """True components of the views that were revealed; nothing before that. ``prior``: its name, for messages."""

    def __init__(self, prior: str) -> None:
        self._prior = prior
        self._components: dict[str, np.ndarray] = {}

    def reveal(self, views: tuple[View, ...], components: Iterable[str]) -> None:
        """Keep ``components`` of ``views``, in their order. Raises InputError when a view lacks one."""
        for component in sorted(components):
            truths = [getattr(view, component) for view in views]
            for view, truth in zip(views, truths, strict=True):
                if truth is None:
                    raise InputError(f"prior={self._prior}: training view {view.name} has no ground-truth {component}")
            self._components[component] = np.stack(truths)

    def __getitem__(self, component: str) -> np.ndarray:
        """(V, H, W, 3), linear, premultiplied by the mask."""
        return self._components[component]

    def check(self, component: str, shape: tuple[int, ...]) -> None:
        """Raise InputError unless views of ``shape`` (V, H, W, 3) were revealed."""
        truth = self._components.get(component)
        if truth is None or truth.shape != shape:
            found = "nothing" if truth is None else f"views of shape {truth.shape}"
            raise InputError(f"prior={self._prior}: asked for images of shape {shape}, was revealed {found}")
