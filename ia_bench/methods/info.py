"""What a method says of itself; known without importing what the method computes with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any

from ia_bench.common.errors import InputError, PluginError
from ia_bench.common.settings import check_fields

if TYPE_CHECKING:
    from ia_bench.scenes.scene import Camera, Scene

AUTO = "auto"
"""The name of a coupling that leaves the choice to the prior."""
HeldOut = Mapping[str, "tuple[tuple[str, Camera], ...]"]
"""Folder of pictures, as ``method=images`` reads them -> name and camera of every view that is scored by one of its pictures."""
PREDICTED = frozenset({"albedo", "roughness", "view_synthesis", "relighting"})
NEEDED = frozenset({"mesh", "uv"})


@dataclass(frozen=True)
class MethodInfo:
    """What a method says of itself. Raises InputError, naming the field, for what cannot be meant.

    Attributes:
        uses_prior: Whether it asks ``problem.prior``.
        sees_truth: Whether it is given the truth; such a method is marked in every table.
        fits_exposures: Whether it heeds ``scene.exposures_differ``; of one that does not, a run says so where it matters.
        turns_light: Whether it heeds ``scene.turning``, likewise.
        needs: What a scene must have for it, some of "mesh" and "uv"; a run of one that lacks it is refused.
        brought: Whether it fits nothing, but takes over what was made elsewhere: it is told ``problem.held_out``, and its result
            says what is ``declared`` in place of what a run measures.
        predicts: What can be scored of it, some of "albedo", "roughness", "view_synthesis" and "relighting".
    """

    uses_prior: bool
    sees_truth: bool = False
    fits_exposures: bool = False
    turns_light: bool = False
    brought: bool = False
    needs: frozenset[str] = NEEDED
    predicts: frozenset[str] = PREDICTED

    def __post_init__(self) -> None:
        for name, known in (("needs", NEEDED), ("predicts", PREDICTED)):
            value = getattr(self, name)
            if not (isinstance(value, frozenset) and value <= known):
                raise InputError(f"{name}: expected a frozenset of some of {', '.join(sorted(known))}, found {value!r}")

    def lacking(self, scene: Scene) -> list[str]:
        """What of ``needs`` the ``scene`` has not got: triangles, or texture coordinates that differ."""
        mesh = scene.mesh
        there = {"mesh": mesh is not None and len(mesh.faces) > 0, "uv": mesh is not None and bool(mesh.uv.any())}
        return sorted(self.needs - {name for name, has in there.items() if has})


def held_out(scene: Scene) -> HeldOut:
    """Which views of a scene are scored by which pictures: maps of test views, renders of novel views by their light."""
    test = tuple((view.name, view.camera) for view in scene.test)
    folders = {"albedo": test, "roughness": test}
    for light in dict.fromkeys(view.light for view in scene.novel):
        views = tuple((view.name, view.camera) for view in scene.novel if view.light == light)
        folders["view_synthesis" if light == "train" else f"relighting/{light}"] = views
    return folders


def check_declarations(name: str, method: Any) -> None:  # noqa: ANN401 (anything may claim to be a method)
    """Raise PluginError, naming the method, unless its class has ``Options``, ``presets`` and ``info`` as the contract says."""
    named = isinstance(method.Options, type) and is_dataclass(method.Options)
    known = {field.name for field in fields(method.Options)} if named else set()
    presets = method.presets.values() if isinstance(method.presets, Mapping) else [None]
    presets_hold = all(isinstance(part, Mapping) and set(part) <= known for part in presets)
    for part, expected, holds in (
        ("Options", "a dataclass", named),
        ("presets", "a mapping of names to options that differ from their defaults", presets_hold),
        ("info", f"a {MethodInfo.__module__}.MethodInfo", isinstance(method.info, MethodInfo)),
    ):
        if not holds:
            raise PluginError(f"method {name}: {part}: expected {expected}, found {getattr(method, part)!r:.100}")
    check_fields(method.info, f"method {name}: info: ")
