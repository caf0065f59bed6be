"""``method=asset``: a mesh with textures that other software recovered, and its light, scored like what a method here recovers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from ia_bench.common.declared import Declared
from ia_bench.common.errors import InputError
from ia_bench.common.files import user_path
from ia_bench.methods.info import MethodInfo

if TYPE_CHECKING:
    import numpy as np

    from ia_bench.methods.contract import Monitor, Problem, Result
    from ia_bench.render.stage import Stage
    from ia_bench.scenes.scene import Mesh, View

OPTION = "method.options."
SAMPLES, TARGETS = 20_000, 100_000  # points of the asset and of the scene's mesh that an alignment compares
ITERATIONS = 100
VIEWS, BACKS = 8, 0.2  # training views in which sides of triangles are looked at, and the share of backs that is told
Row = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class AssetOptions:
    """What is brought, and how it lies.

    Attributes:
        path: The mesh: .glb, .gltf, or .obj with its MTL.
        light: Its lat-long light, OpenEXR or Radiance (row 0 is up, the middle column +x); None leaves view synthesis undefined.
        light_turn: Degrees by which the light is turned about the vertical, counter-clockwise from above; 90 for nvdiffrec's.
        up: The axis of the file that points up.
        matrix: Four rows of four numbers, which move the asset (with z up) to where the scene has it; its light turns with it.
        align: "icp" then moves and scales it to the nearest points of the scene's mesh (Besl and McKay 1992).
        texture_size: Texels along a side to which larger textures are reduced.
        declared: What is said of how it was made.
    """

    path: str = ""
    light: str | None = None
    light_turn: float = 0.0
    up: Literal["y", "z"] = "y"
    matrix: tuple[Row, Row, Row, Row] | None = None
    align: Literal["none", "icp"] = "none"
    texture_size: Annotated[int, Field(ge=1)] | None = None
    declared: Declared = field(default_factory=Declared)


class BroughtAsset:
    """Reads the asset and gives it back; nothing is optimised."""

    Options: ClassVar[type] = AssetOptions
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    info = MethodInfo(uses_prior=False, fits_exposures=True, turns_light=True, brought=True, needs=frozenset())

    def __init__(self, options: AssetOptions) -> None:
        """Nothing is read yet."""
        self._options = options

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> list[Path]:
        """The mesh, what it names, and the light. Raises InputError where one is not there."""
        from ia_bench.render.asset_parts import asset_files

        light = options.get("light")
        found = asset_files(user_path(f"{OPTION}path", options["path"]))
        return found if light is None else [*found, user_path(f"{OPTION}light", light)]

    def fit(self, problem: Problem, *, seed: int, monitor: Monitor) -> Result:
        """Raises InputError for files that cannot be read, and where what cameras see of the mesh is not what masks show."""
        import numpy as np

        from ia_bench.methods.contract import Result
        from ia_bench.render.agreement import check_agreement
        from ia_bench.render.asset_files import moved, read_asset
        from ia_bench.render.reconstruction import TexturedReconstruction
        from ia_bench.render.stage import Stage

        options = self._options
        if options.matrix is not None and options.matrix[3] != (0, 0, 0, 1):
            found = f"{list(options.matrix[3])}: it moves columns, with the translation in the last one"
            raise InputError(f"{OPTION}matrix: expected [0, 0, 0, 1] as its last row, found {found}")
        path = Path(options.path).expanduser()
        asset = read_asset(
            path,
            note=monitor.note,
            up=options.up,
            matrix=None if options.matrix is None else np.array(options.matrix),
            light=None if options.light is None else Path(options.light).expanduser(),
            light_turn=options.light_turn,
            texture_size=options.texture_size,
        )
        if asset.light is None:
            monitor.note(f"{path.name}: no light, so view synthesis is undefined; {OPTION}light=FILE gives one")
        if options.align == "icp":
            target = problem.scene.mesh
            if target is None:
                raise InputError(f"{OPTION}align=icp: expected a scene with a mesh to align to, found none in {problem.scene.name}")
            matrix, residual = aligned(asset.mesh, target)
            asset = moved(asset, matrix)
            scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
            monitor.note(f"{path.name}: aligned by ICP (scale {scale:.4g}); its points are {residual:.2%} of the diagonal away")
        scene = replace(problem.scene, mesh=asset.mesh, source=str(path))
        usual = f"it has to lie where the cameras of the scene see it: {OPTION}up, matrix or align=icp"
        check_agreement(scene, monitor.note, mistakes=_turns(options), usual=usual)
        stage = Stage(asset.mesh, problem.device)
        _tell_backs(path, stage.apart, scene.train[:: max(1, len(scene.train) // VIEWS)], monitor.note)
        return Result(TexturedReconstruction.of(asset, stage, problem.scene.turning), declared=options.declared)


def _tell_backs(path: Path, stage: Stage, views: Sequence[View], note: Callable[[str], None]) -> None:
    """Tell where the views see the backs of triangles, or shading normals that point away from them: both cost light."""
    front = 0
    for gbuffer in stage.gbuffers([view.camera for view in views], 1):
        points = stage.surface(gbuffer.face[:, 0], gbuffer.barycentric[:, 0], gbuffer.seen_from())
        front += int(points.front.sum())
    counts = stage.counts()
    backs, bent = 1 - front / max(counts["points"], 1), counts["bent_normals"] / max(counts["points"], 1)
    if max(backs, bent) > BACKS:
        expected = "expected triangles that are counter-clockwise from outside, with normals that point there"
        note(f"warning: {path.name}: {expected}; cameras see {backs:.0%} backs, and {bent:.0%} normals that point away from them")


def aligned(mesh: Mesh, target: Mesh) -> tuple[np.ndarray, float]:
    """The similarity (4, 4) that ICP finds from ``mesh`` to ``target``, beginning where it is, and what is left.

    That is the mean distance from a point of the mesh to the nearest one of the target, over the diagonal of the target's box.
    """
    import numpy as np
    import trimesh

    solids = [trimesh.Trimesh(one.vertices, one.faces, process=False) for one in (mesh, target)]
    points = [trimesh.sample.sample_surface(one, count, seed=0)[0] for one, count in zip(solids, (SAMPLES, TARGETS), strict=True)]
    options = {"threshold": 0.0, "max_iterations": ITERATIONS, "reflection": False, "scale": True}
    matrix, placed, _ = trimesh.registration.icp(points[0], points[1], **options)
    from scipy.spatial import cKDTree

    distance = cKDTree(points[1]).query(placed)[0].mean()
    return np.asarray(matrix), float(distance / np.linalg.norm(np.ptp(target.vertices, axis=0)))


def _turns(options: AssetOptions) -> dict[str, Any]:
    """What could have been meant: the other axis up, and every way in which axes can be exchanged and turned round."""
    import numpy as np

    from ia_bench.render.asset_files import TO_Z_UP

    def with_mesh_turned(turn: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda camera: np.linalg.inv(turn) @ camera

    other: Literal["y", "z"] = "z" if options.up == "y" else "y"
    now = np.eye(4) if options.matrix is None else np.array(options.matrix)
    found = {f"{OPTION}up={other}": with_mesh_turned(now @ TO_Z_UP[other] @ TO_Z_UP[options.up].T @ np.linalg.inv(now))}
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.eye(4)
        turn[:3, :3] = np.diag(signs) @ np.eye(3)[list(axes)]
        said = "],[".join(",".join(f"{value + 0:g}" for value in row) for row in turn @ now)
        found[f"{OPTION}matrix=[[{said}]]"] = with_mesh_turned(turn)
    return found
