"""What a renderer returns of one view, and how the renders of a light's parts become one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Passes:
    """One rendered view: rgba (H, W, 4) premultiplied; specular, albedo, normal (H, W, 3); roughness, metallic, depth (H, W).

    All but rgba are averages over the pixel's samples, where samples that miss the object count as zero.
    """

    rgba: NDArray[np.float32]
    specular: NDArray[np.float32]
    albedo: NDArray[np.float32]
    normal: NDArray[np.float32]
    roughness: NDArray[np.float32]
    metallic: NDArray[np.float32]
    depth: NDArray[np.float32]


def combine(rendered: list[Passes], counts: list[int]) -> Passes:
    """One view from the renders of a light's parts: radiance adds up; coverage and geometry are averages over samples."""

    def mean(name: str) -> NDArray[np.float32]:
        total = sum(count * getattr(passes, name).astype(np.float64) for passes, count in zip(rendered, counts, strict=True))
        return np.asarray(total / sum(counts), dtype=np.float32)

    rgba = mean("rgba")
    rgba[..., :3] = sum(passes.rgba[..., :3] for passes in rendered)
    return Passes(
        rgba=rgba,
        specular=np.sum([passes.specular for passes in rendered], axis=0, dtype=np.float32),
        albedo=mean("albedo"),
        normal=mean("normal"),
        roughness=mean("roughness"),
        metallic=mean("metallic"),
        depth=mean("depth"),
    )
