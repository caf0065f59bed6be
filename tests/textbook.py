"""The specular BRDF in the textbook's form, in numpy and float64: it shares no code with the renderer."""

import numpy as np


def specular(normal: np.ndarray, view: np.ndarray, incident: np.ndarray, roughness: np.ndarray | float) -> np.ndarray:
    """D F G2 / (4 cos_o), that is the BRDF times the cosine of ``incident``: (...) of unit vectors (..., 3), 0 below the horizon.

    GGX with alpha = roughness^2, Schlick's F with F0 = 0.04, and Smith's G2 = 1 / (1 + L(o) + L(i)).
    """
    alpha2 = np.asarray(roughness) ** 4

    def cosine(w: np.ndarray) -> np.ndarray:
        return (w * normal).sum(-1)

    def tan2(w: np.ndarray) -> np.ndarray:
        return ((w - cosine(w)[..., None] * normal) ** 2).sum(-1) / cosine(w) ** 2

    def smith_lambda(w: np.ndarray) -> np.ndarray:
        return (np.sqrt(1 + alpha2 * tan2(w)) - 1) / 2

    half = view + incident
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    d = 1 / (np.pi * alpha2 * cosine(half) ** 4 * (1 + tan2(half) / alpha2) ** 2)
    f = 0.04 + 0.96 * (1 - (view * half).sum(-1)) ** 5
    g = 1 / (1 + smith_lambda(view) + smith_lambda(incident))
    return np.where(cosine(incident) > 0, d * f * g / (4 * cosine(view)), 0)
