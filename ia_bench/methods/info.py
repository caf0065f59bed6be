"""What a method says of itself; known without importing what the method computes with."""

from __future__ import annotations

from dataclasses import dataclass

PREDICTED = frozenset({"albedo", "roughness", "view_synthesis", "relighting"})


@dataclass(frozen=True)
class MethodInfo:
    """What a method says of itself.

    Attributes:
        uses_prior: Whether it asks ``problem.prior``.
        sees_truth: Whether it is given the truth; such a method is marked in every table.
        needs: What a scene must have for it, some of "mesh" and "uv".
        predicts: What can be scored of it, some of "albedo", "roughness", "view_synthesis" and "relighting".
        paper: Where it was published.
        deviations: In what it differs from there, one sentence each.
    """

    uses_prior: bool
    sees_truth: bool = False
    needs: frozenset[str] = frozenset({"mesh", "uv"})
    predicts: frozenset[str] = PREDICTED
    paper: str = ""
    deviations: tuple[str, ...] = ()
