"""What a prior of albedo and specular shading must be and do; a third party's prior is one class with these members."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from torch import Tensor

from ia_bench.scenes.scene import View

COMPONENTS = ("albedo", "specular")


@runtime_checkable
class Prior(Protocol):
    """A distribution over the albedo and / or the specular shading behind an image (the paper's section 3.2).

    ``provides``: the components it samples, a subset of {"albedo", "specular"} (empty: no prior at all).
    ``stochastic``: whether two seeds may give two samples. ``guidable``: whether :meth:`sample` takes ``guidance``; one
    that does not is asked only once, in stage 1. ``resolution``: side in pixels it works at, None for any.
    ``encoding``: component -> "linear" or "srgb", the space its errors are even in; the trainer compares there, while
    :meth:`sample` always speaks linear. ``sees_truth``: it is handed the scene's ground truth through ``reveal``; such a
    prior is marked in every table. ``network_calls``: network evaluations so far.
    """

    provides: frozenset[str]
    stochastic: bool
    guidable: bool
    resolution: int | None
    encoding: Mapping[str, str]
    sees_truth: bool
    network_calls: int

    def sample(
        self, images: Tensor, masks: Tensor, *, seed: int, guidance: Mapping[str, Tensor] | None = None
    ) -> dict[str, Tensor]:
        """One sample per image of every component in ``provides``: linear, premultiplied by the mask, (V, H, W, 3).

        ``images`` (V, H, W, 3) linear radiance premultiplied by ``masks`` (V, H, W) in [0, 1]. ``guidance`` maps a
        component to its current render (V, H, W, 3), likewise premultiplied; the sample is drawn toward it (the paper's
        equation 8). The same seed and input give the same sample, whatever else was sampled before, and an image's
        sample does not depend on the images beside it.
        """
        ...


@runtime_checkable
class TruthSeer(Protocol):
    """A prior with ``sees_truth``: run.py hands it the training views with ground truth before the first sample."""

    def reveal(self, views: tuple[View, ...]) -> None:
        """Receive the training views, in order, with ``albedo`` and ``specular`` filled in."""
        ...


@runtime_checkable
class Distiller(Protocol):
    """A prior that can be distilled by score (SDS, Poole et al. 2023; the paper's alternative to sampling)."""

    def distill(self, images: Tensor, masks: Tensor, renders: Mapping[str, Tensor], *, seed: int) -> dict[str, Tensor]:
        """Noise ``renders`` to a random level and denoise them in one network call: one estimate of every render.

        ``images``, ``masks`` as in :meth:`Prior.sample`; ``renders`` maps components to their current render (V, H, W, 3),
        linear, premultiplied. The estimates come back for the same components, like samples. The level is drawn from
        ``seed``, one for each image; the same seed and input give the same estimates.
        """
        ...


@runtime_checkable
class Bounded(Protocol):
    """A prior whose samples end at some radiance, as those of display-encoded images do."""

    def ceilings(self, images: Tensor, masks: Tensor) -> dict[str, Tensor]:
        """Component -> (V,), the largest linear value in its samples of these images; what comes near it may be more.

        ``images``, ``masks`` as in :meth:`Prior.sample`. Components without such an end are left out.
        """
        ...


@runtime_checkable
class Patchwise(Protocol):
    """A prior that can predict an image larger than its ``resolution`` in overlapping patches (the paper's equation 6).

    ``patches``: whether it does, or "auto": as the plan says. None: it cannot (a prior around one that cannot).
    """

    @property
    def patches(self) -> bool | str | None:
        """See above."""
        ...

    def use_patches(self, patches: bool) -> None:
        """Receive what the plan says, before the first sample; only where ``patches`` is "auto"."""
        ...


@runtime_checkable
class GeometryReader(Protocol):
    """A prior that can look at the geometry behind the images; it must do without it as well.

    ``reads_geometry``: whether it wants to. Where true, the trainer gives the geometry of the views before it asks about
    them, and again whenever it asks about others.
    """

    reads_geometry: bool

    def give_geometry(self, normals: Tensor, visibility: Tensor) -> None:
        """Receive what the next calls' images show, view by view in their order, until other geometry is given.

        ``normals`` (V, H, W, 3): unit shading normals in the camera's frame (x right, y up, z toward the camera).
        ``visibility`` (V, H, W, 1) in [0, 1]: the cosine-weighted share of the hemisphere around the normal that the
        object leaves open. Both are averages over the pixel, so premultiplied by its coverage, and zero where nothing is
        seen.
        """
        ...


@runtime_checkable
class Fingerprinted(Protocol):
    """A prior whose samples may be kept between runs; one without a fingerprint is asked anew by every run.

    ``fingerprint``: a text that differs whenever its samples could: the class and the version of its code, its options,
    the content of its weights.
    """

    fingerprint: str


@runtime_checkable
class Counted(Protocol):
    """A prior that counts what a reader of its results should know, such as steps that were cut short."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What was counted so far, by name; it goes into the counters of metrics.json."""
        ...
