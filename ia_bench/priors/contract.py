"""What a prior of albedo and specular shading must be and do; a third party's prior is one class with two members."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Protocol, runtime_checkable

import torch
from pydantic import Field
from torch import Tensor

from ia_bench.common.declared import Declared
from ia_bench.common.errors import InputError

COMPONENTS = ("albedo", "specular")
ENCODINGS = ("linear", "srgb")
WANTED = ("normals", "visibility", "view_count", "truth")


@dataclass(frozen=True)
class PriorInfo:
    """What a prior says of itself. Raises InputError, naming the field, for what cannot be meant.

    Attributes:
        provides: The components that it samples, some of "albedo" and "specular"; empty: it is no prior at all.
        stochastic: Whether two seeds may give two samples.
        guidable: Whether a sample can be drawn toward a render; one that cannot is asked only once, in stage 1.
        resolution: Side in pixels at which it works, None for any.
        encoding: Component -> "linear" or "srgb", the space in which its errors are even. Methods compare there; samples
            are linear whatever it says.
        sees_truth: Whether it knows the ground truth; such a prior is marked in every table.
        wants: What its observations should hold besides images, some of "normals", "visibility", "view_count" and "truth". A
            sample must do without the first three as well, which pictures without a scene do not have.
        coupling: The name of the coupling by which it is used best, such as "targets"; None recommends none. It is what a run with
            ``coupling=auto`` takes. The code of one that is not built in identifies the run where the info is the class's own.
        declared: What is said of predictions that were made elsewhere: the seconds that a row took are then its own and these.
            None for a prior that makes them in the run.
    """

    provides: frozenset[str]
    stochastic: bool = False
    guidable: bool = False
    resolution: Annotated[int, Field(ge=1)] | None = None
    encoding: Mapping[str, str] = field(default_factory=lambda: dict.fromkeys(COMPONENTS, "srgb"))
    sees_truth: bool = False
    wants: frozenset[str] = frozenset()
    coupling: Annotated[str, Field(min_length=1)] | None = None
    declared: Declared | None = None

    def __post_init__(self) -> None:
        for name, known in (("provides", COMPONENTS), ("wants", WANTED)):
            value = getattr(self, name)
            if not (isinstance(value, frozenset) and value <= set(known)):
                raise InputError(f"{name}: expected a frozenset of some of {', '.join(known)}, found {value!r}")
        encoding: Any = self.encoding
        if not isinstance(encoding, Mapping) or any(encoding.get(name) not in ENCODINGS for name in self.provides):
            raise InputError(f"encoding: expected one of {', '.join(ENCODINGS)} for every component provided, found {encoding!r}")
        if "truth" in self.wants and not self.sees_truth:
            raise InputError("wants: expected sees_truth=True of a prior that wants truth, found False")


@dataclass(frozen=True)
class Observations:
    """What a prior is shown of V images of one size: finite, on the CPU, in float32.

    Attributes:
        images: (V, H, W, 3) linear radiance, premultiplied by the masks.
        masks: (V, H, W) coverage in [0, 1].
        views: Which training views these are, None for pictures that are no views of a scene.
        normals: (V, H, W, 3) shading normals in the camera's frame (x right, y up, z toward the camera), averaged over the
            pixel and so premultiplied by its coverage; None where the prior does not want them or nobody knows them.
        visibility: (V, H, W, 1) in [0, 1]: cosine-weighted share of the hemisphere around the normal that the object leaves
            open, premultiplied likewise, or None likewise.
        view_count: (V, H, W, 1), how many of the scene's training photographs show the place that a pixel shows, 0 where it shows
            none; not premultiplied. None likewise.
        truth: Component -> (V, H, W, 3), ground truth, only for a prior that wants it.
        names: What the scene calls the views, None for pictures that are no views of a scene.
        sizes: (height, width) of the photographs, where images are these with black added at the right and at the bottom.
    """

    images: Tensor
    masks: Tensor
    views: tuple[int, ...] | None = None
    normals: Tensor | None = None
    visibility: Tensor | None = None
    view_count: Tensor | None = None
    truth: Mapping[str, Tensor] | None = None
    names: tuple[str, ...] | None = None
    sizes: tuple[tuple[int, int], ...] | None = None

    def copy(self) -> Observations:
        """The same in memory of its own."""
        return self.each(torch.clone)

    def select(self, rows: list[int]) -> Observations:
        """Some of the images, in the order of ``rows``."""
        views = self.views and tuple(self.views[row] for row in rows)
        names = self.names and tuple(self.names[row] for row in rows)
        sizes = self.sizes and tuple(self.sizes[row] for row in rows)
        return replace(self.each(lambda tensor: tensor[rows]), views=views, names=names, sizes=sizes)

    def each(self, change: Callable[[Tensor], Tensor]) -> Observations:
        """The same with every tensor (V, ...) changed."""
        changed: dict[str, Any] = {name: change(value) for name, value in vars(self).items() if isinstance(value, Tensor)}
        truth = None if self.truth is None else {name: change(tensor) for name, tensor in self.truth.items()}
        return replace(self, **changed, truth=truth)


@dataclass(frozen=True)
class Samples:
    """What a prior answers.

    Attributes:
        values: Component -> (V, H, W, 3) float32 on the CPU: linear, premultiplied by the masks. A corrected roughness has one
            channel.
        ceilings: Component -> (V,), the largest linear value that a sample of each image can have, as display-encoded images
            end at white; what comes near it may be more. Components without such an end are left out.
        cost: Name -> how many, of this call alone: "network_calls" (one per image and evaluation), and whatever else a
            reader of the results should know, such as steps that were cut short. It goes into the counters of metrics.json.
    """

    values: Mapping[str, Tensor]
    ceilings: Mapping[str, Tensor] = field(default_factory=dict)
    cost: Mapping[str, int] = field(default_factory=dict)


@runtime_checkable
class Prior(Protocol):
    """A distribution over the albedo and / or the specular shading behind an image (the paper's section 3.2).

    One that has a ``fingerprint``, a text that differs whenever its samples could (the class and the version of its code, its
    options, the content of its weights), has its samples kept between runs; any other is asked anew by every run.

    A run is known by the prior's code and options, and by the content of the files that it takes numbers from, such as weights:
    those that a class method ``files(options)`` of it returns, or, of a prior without one, those that its options name by a path.
    ``weights=./net`` is one, ``weights=net`` a word: trained anew, a folder called so is not told from what it was before.
    """

    info: PriorInfo

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """One sample per image of every component that the info provides.

        ``guidance`` maps a component to its current render (V, H, W, 3), premultiplied; the sample is drawn toward it (the
        paper's equation 8). The same seed and input give the same sample, whatever else was sampled before, and an image's
        sample does not depend on the images beside it.
        """
        ...


class NoPrior:
    """``prior=none``: the images alone, and every other prior's opponent. It provides nothing, for any input."""

    info = PriorInfo(frozenset())

    def sample(self, observations: Observations, *, seed: int, guidance: Mapping[str, Tensor] | None = None) -> Samples:
        """Nothing."""
        return Samples({})


@runtime_checkable
class Distiller(Protocol):
    """A prior that can be distilled by score (SDS, Poole et al. 2023; the paper's alternative to sampling)."""

    def distill(self, observations: Observations, renders: Mapping[str, Tensor], *, seed: int) -> Samples:
        """Noise ``renders`` to a random level and denoise them in one network call: one estimate of every render.

        ``renders`` maps every component that is provided to its current render (V, H, W, 3), linear, premultiplied. The
        estimates come back for the same components, like samples. The level is drawn from ``seed``, one for each image; the
        same seed and input give the same estimates.
        """
        ...


@runtime_checkable
class Refiner(Protocol):
    """A prior that can correct what a fit has recovered: it knows what fits get wrong, not only what materials look like."""

    def refine(self, observations: Observations, renders: Mapping[str, Tensor]) -> Samples:
        """The material that a fit shows in training photographs, corrected.

        ``renders`` maps "albedo", "radiance" (the photograph as the fit renders it) and "specular" (the specular shading in it) to
        (V, H, W, 3), linear, "roughness" to (V, H, W, 1), perceptual, and "evidence" to (V, H, W, 2): what these photographs
        together say about a place, how much the fit's radiance is off and how much of it is specular, as
        :func:`ia_bench.methods.regularisers.refiner.evidence` has it. All are premultiplied. ``observations`` hold whatever the
        info ``wants`` but truth.

        The answer holds an "albedo" (V, H, W, 3), on whose level and colour nothing depends, and a "roughness" (V, H, W, 1) if the
        prior has one. It is always the same for the same input, and an image's does not depend on the images beside it.
        """
        ...
