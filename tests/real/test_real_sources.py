"""The lists of datasets/real: complete, consistent, and what training may see of them."""

import hashlib
import re
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from ia_bench.common.errors import InputError
from ia_bench_training import real_sources
from ia_bench_training.real_sources import closed_set, expect_open, open_files, why_closed
from ia_bench_training.world import banks
from ia_bench_training.world.make import _meshes

LISTS = real_sources.LISTS


def sums(name: str) -> dict[str, str]:
    lines = (LISTS / name).read_text("utf-8").splitlines()
    return {path: digest for digest, path in (line.split("  ", 1) for line in lines)}


@pytest.mark.parametrize(("sources", "listed"), [("sources.toml", "sums.sha256"), ("sources_nc.toml", "sums_nc.sha256")])
def test_every_file_has_one_source_and_every_source_its_licence(sources: str, listed: str) -> None:
    content = tomllib.loads((LISTS / sources).read_text("utf-8"))
    for source in content["source"]:
        assert {"repository", "commit", "licence", "attribution", "changed"} <= source.keys(), source
        assert re.fullmatch(r"[0-9a-f]{10}([0-9a-f]{30})?", source["commit"]), source
        assert "recipe" not in source or source["recipe"] in ("mean_of_2x2", "llff")
    named = [name for one in content["source"] + content.get("made", []) for name in (*one.get("files", []), *one.get("paths", {}))]
    for path in sums(listed):
        assert sum(path == name or (name.endswith("/") and path.startswith(name)) for name in named) == 1, path


def test_no_non_commercial_licence_among_the_free_ones() -> None:
    content = tomllib.loads((LISTS / "sources.toml").read_text("utf-8"))
    assert not [source for source in content["source"] if re.search(r"\bNC\b|non-?commercial", source["licence"], re.IGNORECASE)]
    assert all(path.startswith("nc/") for path in sums("sums_nc.sha256"))
    assert not [path for path in sums("sums.sha256") if path.startswith("nc/")]


def test_training_sees_open_files_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free, evaluated, bought, unknown = (tmp_path / name for name in ("free", "evaluated", "nc", "unknown"))
    for path in (free, evaluated, bought, unknown):
        path.write_text(path.name)
    digest = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (free, evaluated, bought)}
    lists = tmp_path / "lists"
    lists.mkdir()
    (lists / "sources.toml").write_text('[[closed]]\nfiles = ["lights/seen/"]\nwhy = "results are measured on it"\n')
    (lists / "sums.sha256").write_text(f"{digest['free']}  lights/free.hdr\n{digest['evaluated']}  lights/seen/evaluated.hdr\n")
    (lists / "sums_nc.sha256").write_text(f"{digest['nc']}  nc/objects/bust.glb\n")
    monkeypatch.setattr(real_sources, "LISTS", lists)
    assert open_files([free, evaluated, bought, unknown]) == [free]
    for path, why in ((evaluated, "results are measured on it"), (bought, "non-commercial"), (unknown, "does not list it")):
        with pytest.raises(InputError, match=why):
            expect_open(path)


def test_the_real_data_is_what_is_listed(real_data: Path, fetch: ModuleType, tmp_path: Path) -> None:
    assert why_closed(real_data / "captures/banana/images/DSC_0423.jpg") == "table=captures"
    lights = sorted((real_data / "lights").glob("*.hdr"))
    closed = {"scans": closed_set("scans"), "held_out": closed_set("held_out")}
    assert (len(closed["scans"]), len(closed["held_out"])) == (16, 28)
    shut = {real_data / name for names in closed.values() for name in names}
    assert open_files(lights) == [path for path in lights if path not in shut]
    assert not open_files(sorted(shut))
    assert not open_files(sorted((real_data / "lights/also_in_pmndrs_assets").glob("*.hdr")))
    assert fetch.main(["--from", str(real_data), "--out", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["captures", "lights", "objects", "textures"]


def test_a_world_refuses_what_results_are_measured_on(real_data: Path) -> None:
    closed = {real_data / name for kind in ("scans", "held_out") for name in closed_set(kind)}
    assert closed.isdisjoint(_meshes(real_data))
    lights = [path for path in closed if path.suffix == ".hdr"] + sorted((real_data / "lights/also_in_pmndrs_assets").iterdir())
    shipped = sorted((LISTS.parent / "scenes").glob("*/lights/*")) + sorted((LISTS.parent / "lights").glob("*.exr"))
    assert shipped
    for path in lights + shipped:
        with pytest.raises(InputError, match="open to training, found a file that is not"):
            banks.photographed(path, np.random.default_rng(0))
