"""What a run recovered, read back from its folder: for pictures, benchmarks, and scores under another protocol."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import torch

from ia_bench.capture.capture import captured
from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.files import user_path
from ia_bench.common.machine import commit
from ia_bench.common.progress import Begin, Progress, unseen
from ia_bench.common.settings import parsed
from ia_bench.material.textures import Material
from ia_bench.methods.images import ORDERS, BroughtPictures, ImagesOptions
from ia_bench.methods.info import held_out
from ia_bench.render.asset_files import read_asset
from ia_bench.render.reconstruction import ADDED, Reconstruction, TexturedReconstruction
from ia_bench.render.settings import BROUGHT
from ia_bench.render.stage import Stage
from ia_bench.runs.config import cell_name, config_of
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.identity import hash_of, protocol_hash, scene_content
from ia_bench.runs.packs import BROUGHT_PICTURES, ORDER
from ia_bench.runs.pictures.packing import write_bundle
from ia_bench.runs.record import CONFIG, METRICS_FILE, RunRecord, RunSetup, finished_record
from ia_bench.runs.scene import read_scene
from ia_bench.scenes.exr import read_exr
from ia_bench.scenes.scene import Scene
from ia_bench.scenes.turning import TurningLight
from ia_bench.scores.evaluate import Scores, drawn_scale
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.scorer import Scorer

ASSETS = ("albedo.exr", "roughness.exr", "metallic.exr", "light.exr", "asset.glb")


class Recovered:
    """A finished run.

    Attributes:
        folder: The run's folder, absolute.
        record: Its metrics.json.
        setup: Its config.json.
        config: The configuration in it.
        scene_content: The hash of the files of its scene.
        scale: (3,), what aligned the albedo of its textures in its scores; ones where it cannot be aligned.
        device: Where it was scored, the CPU where this machine has no GPU: renders differ in their last bits.
    """

    def __init__(self, folder: Path) -> None:
        """Raises InputError for a run without results, or whose files lack a key."""
        self.record = RunRecord.read(folder)
        if self.record.status != "ok":
            raise InputError(f"{folder / METRICS_FILE}: expected a finished run, found status {self.record.status!r}")
        self.folder, self.setup = folder.absolute(), RunSetup.read(folder)
        self.config = config_of(folder)
        on_gpu = self.config.device == "cuda" and torch.cuda.is_available()
        self.device = torch.device("cuda" if on_gpu else "cpu")
        scene = self.setup.identity.get("scene")
        self.scene_content = scene.get("content") if isinstance(scene, dict) else None
        alignment = str(self.record.protocol_description.get("alignment"))
        self.scale = torch.tensor(drawn_scale(self.record.albedo_scales, alignment) or [1.0] * 3)

    def has(self, name: str) -> bool:
        """Whether the run wrote a file of that name; what a failed run of another configuration has left is none of its own."""
        return (self.folder / name).is_file() and (not self.record.files or name in self.record.files)

    def read_scene(self, folder: Path | None = None, *, whole: bool = False) -> Scene:
        """The run's scene with its truth, as it was captured, or ``whole``: from ``folder``, or where the run found it.

        Raises InputError unless it is the run's scene to the byte: maps fit no other mesh.
        """
        scene = self.config.scene
        if folder is not None:
            scene = replace(scene, path=str(user_path("scene.path", str(folder), folder=True)))
        if scene_content(scene, self.config.reader) != self.scene_content:
            raise InputError(
                f"{self.folder / CONFIG}: expected the files of the run's scene, {scene.name}, found other ones in "
                f"{scene.path or 'the folders of scenes'}: the run was on another scene, or a file of the scene has changed since"
            )
        found = read_scene(scene, self.config.reader, truth=True)
        return found if whole else captured(found, self.config.capture, lambda line: None)

    def reconstruction(self, stage: Stage) -> TexturedReconstruction:
        """What the run recovered, on a stage of its scene's mesh, or on its own; some methods recover no light of the whole scene.

        Raises InputError where a texture is missing.
        """

        def texture(name: str, channels: int) -> torch.Tensor:
            return torch.from_numpy(read_exr(self.folder / f"{name}.exr", channels)).to(stage.device)

        def optional(name: str, channels: int) -> torch.Tensor | None:
            return texture(name, channels) if self.has(f"{name}.exr") else None

        assumed = frozenset[str]()
        if self.config.method.target == registry.built_in("method")["asset"].target:  # whose mesh may be another one
            stage = Stage(read_asset(self.folder / "asset.glb", note=lambda line: None).mesh, stage.device)
            unknown = self.record.reasons.get("roughness.mse", "").startswith("the method does not predict")
            assumed = frozenset({"roughness"} if unknown else ())
        material = Material(texture("albedo", 3), texture("roughness", 1), optional("metallic", 1))
        heeded = self.record.counts.get("textures", {}).get("light_turns", 1)  # not told in former records
        turning = self.record.capture.get("turning") if heeded else None
        coat = "added" if ADDED in self.record.renderer else "layered"  # of a brought asset, whatever its run was given
        return TexturedReconstruction(
            stage, material, optional("light", 3), coat=coat, assumed=assumed, turning=turning and TurningLight.of_record(turning)
        )

    def pictures(self, scene: Scene) -> BroughtPictures | None:
        """The pictures that method=images scored, where a pack has put them into the run's folder; None otherwise."""
        folder = self.folder / BROUGHT_PICTURES
        if self.record.renderer != BROUGHT or not folder.is_dir():
            return None
        options = {**self.config.method.options, "path": str(folder)}
        if options["order"] not in ORDERS:
            options["order"] = str(folder / ORDER)
        return BroughtPictures(parsed(ImagesOptions, options), held_out(scene))


class Rescorer:
    """Scores again what runs have recovered. Successive runs of one scene, under one protocol, share its G-buffers."""

    def __init__(self) -> None:
        self._key: object = None

    def rescore(
        self, folder: Path, protocol: Protocol, out: Path, scene: Path | None = None, progress: Progress | None = None
    ) -> Path:
        """Score the run in ``folder`` and return its new folder below ``out``, in which it may be finished already.

        Scores are new; all that the run took (seconds, rays, memory, machine) is what it was, and ``rescored_from`` says
        which run that is. A curve cannot be scored again, so there is none.

        Raises:
            InputError: As :meth:`score`, and for a run that has not finished.
        """
        run = Recovered(folder)
        record = run.record
        content = {**run.setup.identity, "protocol": protocol.describe(), "rescored_from": record.config_hash}
        key = hash_of(content)
        place = out / cell_name(record.scene, record.row, record.seed, key)
        given = {"command": run.setup.command, "config": {**run.setup.config, "protocol": asdict(protocol)}}
        progress = progress or Progress(quiet=True)
        if finished_record(place, key, progress.note) is not None:
            return place
        scores = self.score(run, protocol, scene, progress.task).as_dict()  # before a folder is made: it may not be possible
        scale = drawn_scale(scores["albedo_scales"], protocol.alignment)
        title = f"{record.scene}, {record.row}, seed {record.seed}"
        with RunFolder(place, content, key, setup=given) as kept:
            if kept.finished() is not None:  # by another process, while this one scored
                return place
            write_bundle(kept, self._scene, self._scorer.drawn, scale, title, progress)
            for name in ASSETS:
                if run.has(name):
                    kept.write_bytes(name, (folder / name).read_bytes())
            origin: dict[str, str | None] = {"config_hash": record.config_hash, "protocol": record.protocol}
            origin |= {"commit": record.environment.get("commit"), "scored_by_commit": commit()}
            kept.write_record(replace(record, **scores, protocol_hash=protocol_hash(content), rescored_from=origin))
        return place

    def score(self, run: Recovered, protocol: Protocol, scene: Path | None = None, begin: Begin = unseen) -> Scores:
        """What the textures of a run score under a ``protocol``; ``begin`` shows how far it is.

        ``scene``: the folder of its scene, None for where the run found it.

        Raises InputError for a run of another scene, one that has left no textures, and one that was drawn by a renderer of its
        own, which is not stored: what the reference renderer makes of its textures is no score of the same row.
        """
        config = run.config
        key = (protocol, scene, config.scene, run.scene_content, config.reader, config.capture, run.device)
        if key != self._key:  # another scene than that of the run before
            self._key = None  # of which nothing is kept from here on, also where this one cannot be scored
            self._scene = run.read_scene(scene)
            self._stage = Stage(self._scene.expect_mesh(), run.device)
            self._scorer = Scorer(self._scene, protocol, run.device)
            self._key = key
        pictures = run.pictures(self._scene)
        if pictures is None and run.record.renderer == BROUGHT:
            raise InputError(
                f"{run.folder / BROUGHT_PICTURES}: expected the pictures that were scored, as a pack keeps them, found none; score "
                f"them again with protocol={protocol.name}"
            )
        reconstruction: Reconstruction = pictures or run.reconstruction(self._stage)
        if run.record.renderer != reconstruction.renderer:
            raise InputError(
                f"{run.folder / METRICS_FILE}: renderer: expected {reconstruction.renderer}, found {run.record.renderer}: its own "
                f"renderer is gone; run it again with protocol={protocol.name}"
            )
        return self._scorer.full(reconstruction, begin)
