"""Mitsuba's scene as benchmarks and tests need it: gradients in the shapes of ours, and its integrator of direct light alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from ia_bench_baselines.mitsuba_adam.scene import MitsubaScene


class TrackedScene(MitsubaScene):
    """A scene of which gradients are read, by texel: :meth:`track`, ``dr.backward`` of a render, :meth:`gradients`."""

    def track(self) -> None:
        """Forget earlier gradients and record new ones of albedo, roughness and light."""
        self._leaves: dict[str, Any] = {}  # what gradients are taken of: the scene may keep something derived from it
        for ours, name in self.names.items():
            self._leaves[ours] = type(self.parameters[name])(self.dr.detach(self.parameters[name]))
            self.dr.enable_grad(self._leaves[ours])
            self.parameters[name] = self._leaves[ours]
        self.parameters.update()

    def evaluate_gradients(self) -> None:
        """Compute the gradients after ``dr.backward`` and wait for them."""
        self.dr.eval(*[self.dr.grad(leaf) for leaf in self._leaves.values()])
        self.dr.sync_thread()

    def gradients(self) -> dict[str, np.ndarray]:
        """Evaluated gradients in our shapes: albedo (H, W, 3), roughness (H, W, 1), light (H, 2 H, 3).

        Mitsuba keeps the light's last and first column once more on the other side; what it found there is added.
        """
        grads = {ours: np.array(self.dr.grad(leaf)) for ours, leaf in self._leaves.items()}
        padded = grads["light"][..., :3]
        light = padded[:, 1:-1].copy()
        light[:, -1] += padded[:, 0]
        light[:, 0] += padded[:, -1]
        return {**grads, "light": light}


class DirectScene(TrackedScene):
    """The same with Mitsuba's integrator of direct light, which takes more than one sample of each technique a camera ray."""

    samples_per_ray = 8

    def integrator(self, depth: int) -> dict[str, Any]:
        """What Mitsuba calls "direct"; there are no longer paths, whatever ``depth`` is."""
        return {"type": "direct", "bsdf_samples": 4, "emitter_samples": 4, "hide_emitters": True}


SCENES = {"direct": DirectScene, "prb": TrackedScene}
"""By the name of Mitsuba's integrator."""
