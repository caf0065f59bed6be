"""Finished runs scored again, under another protocol: nothing is fitted, what the run left is read back."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import torch

from ia_bench.common.errors import InputError
from ia_bench.common.machine import commit
from ia_bench.render.stage import Stage
from ia_bench.runs.config import slug
from ia_bench.runs.folder import RunFolder
from ia_bench.runs.identity import hash_of, labels, setup
from ia_bench.runs.pictures.bundle import write_pictures
from ia_bench.runs.record import METRICS_FILE
from ia_bench.runs.recovered import Recovered
from ia_bench.scores.protocol import Protocol
from ia_bench.scores.result import drawn_scale
from ia_bench.scores.scorer import Scorer

ASSETS = ("albedo.exr", "roughness.exr", "metallic.exr", "light.exr", "asset.glb")


class Rescorer:
    """Scores runs under one protocol, each in a new folder below ``out``. Successive runs of one scene share its G-buffers.

    Attributes:
        protocol: What the new scores follow.
        out: Where the new run folders are made.
        scene: Folder of the runs' scene, None for where the runs found it.
    """

    def __init__(self, protocol: Protocol, out: Path, scene: Path | None = None) -> None:
        self.protocol, self.out, self.scene = protocol, out, scene
        self._key: object = None

    def rescore(self, folder: Path) -> Path:
        """Score the run in ``folder`` and return its new folder, in which it may be finished already.

        Scores are new; all that the run took (seconds, rays, memory, machine) is what it was, and ``rescored_from`` says
        which run that is. A curve cannot be scored again, so there is none.

        Raises:
            InputError: The run has not finished, is of another scene, has left no textures, or was drawn by a renderer of its
                own, which is not stored: what the reference renderer makes of its textures is no score of the same row.
        """
        run = Recovered(folder)
        record, config = run.record, replace(run.config, protocol=self.protocol)
        content = {**run.setup.identity, "protocol": self.protocol.describe(), "rescored_from": record.config_hash}
        key = hash_of(content)
        place = self.out / slug(record.scene) / f"{slug(record.row)}-seed{record.seed}-{key[:8]}"
        with RunFolder(place, content, key, setup={**setup(config), "command": run.setup.command}) as kept:
            if kept.finished() is not None:
                return place
            stage, scorer = self._scene_of(run)
            reconstruction = run.reconstruction(stage)
            if record.renderer != reconstruction.renderer:
                raise InputError(
                    f"{folder / METRICS_FILE}: renderer: expected {reconstruction.renderer}, found {record.renderer}: its own "
                    f"renderer is gone; run it again with protocol={self.protocol.name}"
                )
            scores = scorer.full(reconstruction).as_dict()
            scale = drawn_scale(scores["albedo_scales"], self.protocol.alignment)
            write_pictures(kept, self._scene, scorer.drawn, scale, print)
            for name in ASSETS:
                if (folder / name).is_file():
                    with kept.path_for(name) as path:
                        shutil.copyfile(folder / name, path)
            origin: dict[str, str | None] = {"config_hash": record.config_hash, "protocol": record.protocol}
            origin |= {"commit": record.environment.get("commit"), "scored_by_commit": commit()}
            protocol = {"protocol_hash": labels(config, content)["protocol_hash"]}
            kept.write_record(replace(record, **scores, **protocol, rescored_from=origin))
        return place

    def _scene_of(self, run: Recovered) -> tuple[Stage, Scorer]:
        """The stage and the scorer of the run's scene; those of the run before where that is the same."""
        on_gpu = run.config.device == "cuda" and torch.cuda.is_available()  # as the scores of the run itself are
        device = torch.device("cuda" if on_gpu else "cpu")
        key = (run.scene_content, run.config.reader, run.config.capture, device)
        if key != self._key:
            scene = run.read_scene(self.scene)
            self._stage, self._scorer = Stage(scene.expect_mesh(), device), Scorer(scene, self.protocol, device)
            self._key, self._scene = key, scene
        return self._stage, self._scorer
