"""Packs through the command line: what is packed is verified, whatever is manipulated is found, and a board has rows by authors."""

import errno
import hashlib
import json
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from coarse import COARSE

from ia_bench.cli.main import main
from ia_bench.common.errors import InputError
from ia_bench.common.paths import scenes_folders
from ia_bench.runs import packs

SMALL = ["scene=tiny", "preset=smoke", "threads=1", *COARSE]
Files = dict[str, bytes]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs in one folder, of no prior and of the oracle."""
    folder = tmp_path_factory.mktemp("runs")
    for prior in ("none", "oracle"):
        assert main(["run", *SMALL, f"prior={prior}", f"out={folder / prior}"]) == 0
    return folder


@pytest.fixture(scope="module")
def pack(runs: Path) -> Path:
    """The run without a prior, packed."""
    return packed(runs / "none", runs / "packs" / "ours.zip", "A. Author")


def packed(run: Path, out: Path, authors: str) -> Path:
    assert main(["pack", str(run), "--out", str(out), "--authors", authors, "--url", "https://example.org/paper"]) == 0
    return out


def files_of(pack: Path) -> Files:
    with zipfile.ZipFile(pack) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def spoiled(pack: Path, out: Path, spoil: Callable[[Files, str], None], *, hashed: bool = False) -> str:
    """Write the pack after ``spoil`` was at its files, told its run's folder; ``hashed``: with hashes that fit."""
    files = files_of(pack)
    manifest = json.loads(files["manifest.json"])
    run = manifest["runs"][0]
    spoil(files, run["folder"])
    if hashed:
        run["files"] = {name: hashlib.sha256(files[f"{run['folder']}/{name}"]).hexdigest() for name in run["files"]}
        files["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return str(out)


def changed(name: str, change: Callable[[Any], None]) -> Callable[[Files, str], None]:
    """A spoiling that changes what a JSON file holds."""

    def spoil(files: Files, folder: str) -> None:
        content = json.loads(files[f"{folder}/{name}"])
        change(content)
        files[f"{folder}/{name}"] = json.dumps(content).encode()

    return spoil


def no_room(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def better(record: Any) -> None:
    record["metrics"]["albedo"]["psnr"] += 3


def test_what_was_packed_is_verified_and_the_same_runs_give_the_same_bytes(
    runs: Path, pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert packed(runs / "none", tmp_path / "again.zip", "A. Author").read_bytes() == pack.read_bytes()
    assert main(["verify", str(pack), "--out", str(tmp_path / "result.json")]) == 0
    assert "ours.zip: none, tiny, seed 0: verified\n1 verified; tolerated: psnr 0.02" in capsys.readouterr().out
    (states,) = json.loads((tmp_path / "result.json").read_text())["packs"].values()
    assert list(states.values()) == ["verified"]


def test_the_home_folder_is_taken_out_where_a_path_begins(runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    run = shutil.copytree(runs / "none", tmp_path / "none")
    setup = json.loads((run / "config.json").read_text())
    setup["command"] = "ia-bench run scene.path=/home/somebody/objects/hat out=/mnt/home/somebody/runs"
    (run / "config.json").write_text(json.dumps(setup))
    files = files_of(packed(run, tmp_path / "a.zip", "A. Author"))
    (config,) = (json.loads(content) for name, content in files.items() if name.endswith("config.json"))
    assert config["command"] == "ia-bench run scene.path=~/objects/hat out=/mnt/home/somebody/runs"


@pytest.mark.parametrize("hashed", [False, True])
def test_a_manipulated_score_is_found_with_and_without_fitting_hashes(
    pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], *, hashed: bool
) -> None:
    assert main(["verify", spoiled(pack, tmp_path / "a.zip", changed("metrics.json", better), hashed=hashed)]) == 1
    told = capsys.readouterr().out
    assert "metrics.albedo.psnr: the record says" in told
    assert "3 apart where 0.02 is tolerated" in told
    assert ("metrics.json: expected the hash in the manifest, found another one" in told) != hashed


def test_a_changed_map_is_found_by_both(runs: Path, pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def exchange(files: Files, folder: str) -> None:
        files[f"{folder}/albedo.exr"] = (runs / "oracle" / "albedo.exr").read_bytes()

    assert main(["verify", spoiled(pack, tmp_path / "a.zip", exchange)]) == 1
    told = capsys.readouterr().out
    assert "albedo.exr: expected the hash in the manifest and the record, found another one" in told
    assert "apart where" in told


def test_another_scene_is_found(pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = shutil.copytree(scenes_folders()[0] / "tiny", tmp_path / "tiny")
    (scene / "mesh.ply").write_bytes((scene / "mesh.ply").read_bytes() + b"\n")
    assert main(["verify", str(pack), "--scene", f"tiny={scene}"]) == 1
    told = capsys.readouterr().out
    assert "not scored again" in told
    assert "expected the files of the run's scene, tiny, found other ones" in told


def test_a_broken_pack_is_one_sentence_and_the_others_go_on(
    pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.zip").write_bytes(pack.read_bytes()[:-3000])
    shutil.copyfile(pack, tmp_path / "whole.zip")
    with monkeypatch.context() as full:
        full.setattr(zipfile.ZipFile, "extract", no_room)
        assert main(["verify", str(tmp_path / "whole.zip")]) == 1
        assert re.search(r"whole\.zip: cannot be unpacked into .* \(No space left on device\)", capsys.readouterr().err)
    assert main(["verify", str(tmp_path)]) == 1
    told = capsys.readouterr()
    assert "broken.zip: expected a pack, found no readable zip file" in told.err
    assert "1 verified" in told.out
    assert main(["verify", str(tmp_path / "nothing.zip")]) == 2


def test_no_code_is_run_that_a_pack_names(pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()

    def foreign(setup: Any) -> None:
        setup["config"]["reader"] = {"name": "mine", "target": "shutil:rmtree", "options": {}}
        setup["config"]["scene"]["path"] = str(victim)

    path = spoiled(pack, tmp_path / "a.zip", changed("config.json", foreign), hashed=True)
    assert main(["verify", path]) == 1
    assert "reader: expected one that is installed here, found shutil:rmtree" in capsys.readouterr().out
    assert main(["board", path, "--out", str(tmp_path / "board")]) == 2
    assert victim.is_dir()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("../evil.txt", "does not list ../evil.txt"),
        ("evil.txt", "does not list evil.txt"),
        ("large", "expected at most 20000 files and 0 MB in a pack, found "),
    ],
)
def test_what_leads_out_of_a_pack_or_is_too_large_is_refused(
    name: str, says: str, pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.zip"
    shutil.copyfile(pack, path)
    if name == "large":
        monkeypatch.setattr(packs, "ALL_BYTES", 1 << 10)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, b"of somebody else")
    assert main(["verify", str(path)]) == 1
    assert says in capsys.readouterr().err
    assert not (tmp_path / "evil.txt").exists()


@pytest.mark.parametrize("folder", ["../..", "/tmp", "runs/../../victim", ""])
def test_a_manifest_that_leads_out_of_the_pack_is_refused(pack: Path, tmp_path: Path, folder: str) -> None:
    """Nothing is written there, and nothing that lies there is taken for a file of the pack."""
    files = files_of(pack)
    manifest = json.loads(files["manifest.json"])
    manifest["runs"].append({"folder": folder, "files": {"evil.txt": "0"}})
    files |= {"manifest.json": json.dumps(manifest).encode(), f"{folder}/evil.txt": b"of somebody else"}
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    with pytest.raises(InputError, match=r"runs\.1\.folder: expected a path in the pack"):
        packs.unpack(tmp_path / "a.zip", tmp_path / "deep" / "down")
    assert not list(tmp_path.glob("**/evil.txt"))


@pytest.mark.parametrize("label", ["scene", "seed"])
def test_a_run_that_was_made_of_another_cell_than_it_says_is_found(
    pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], label: str
) -> None:
    other = {"scene": "hat", "seed": 7}[label]
    path = spoiled(pack, tmp_path / "a.zip", changed("metrics.json", lambda record: record.update({label: other})), hashed=True)
    assert main(["verify", path]) == 1
    assert f"metrics.json: {label} is {other}, and " in capsys.readouterr().out


def test_one_odd_pack_does_not_spoil_the_board(pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same run once more, a commit that is none, and a note that would move the terminal's cursor."""
    shutil.copyfile(pack, tmp_path / "again.zip")

    def odd(record: dict[str, Any]) -> None:
        record["seed"], record["environment"]["commit"] = 3, ["a", "b"]

    listed = spoiled(pack, tmp_path / "listed.zip", changed("metrics.json", odd), hashed=True)
    files = files_of(Path(listed))
    manifest = json.loads(files["manifest.json"]) | {"note": "fine\x1b[2J\nia_bench: all packs verified"}
    with zipfile.ZipFile(listed, "w") as archive:
        for name, content in (files | {"manifest.json": json.dumps(manifest).encode()}).items():
            archive.writestr(name, content)
    assert main(["board", str(pack), str(tmp_path / "again.zip"), listed, "--out", str(tmp_path / "board")]) == 1
    told = capsys.readouterr()
    assert "expected one run of none, tiny, 0 by A. Author, found another; the pack is left out" in told.err
    assert "\x1b" not in told.out
    assert "ia_bench: all packs verified" not in told.out.splitlines()
    assert (tmp_path / "board" / "page" / "index.html").is_file()


def test_a_board_tells_who_brought_a_row_and_if_it_is_verified(
    runs: Path, pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = packed(runs / "oracle", tmp_path / "other.zip", "B. Other | <C>")
    assert main(["verify", str(pack), "--out", str(tmp_path / "result.json")]) == 0
    damaged = spoiled(pack, tmp_path / "damaged.zip", changed("metrics.json", better))
    (tmp_path / "more" / "unread.zip").mkdir(parents=True)
    given = map(str, [pack, other, damaged, tmp_path / "more"])
    options = ["--out", str(tmp_path / "board"), "--verified", str(tmp_path / "result.json"), "--reference", "none (A. Author)"]
    kept = [tmp_path / "board" / "packs" / name for name in ("mine.zip", "mine/notes.txt")]  # the folder may be somebody's
    for path in kept:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("of mine")
    assert main(["board", *given, *options]) == 1  # packs were left out
    told = capsys.readouterr()
    assert "unread.zip: expected a pack, found none that can be read; the pack is left out" in told.err
    assert "damaged.zip: runs/tiny/none" in told.err
    assert "| none (A. Author, verified) |" in told.out
    assert "brought by A. Author https://example.org/paper; 1 of 1 runs scored again with the same result" in told.out
    assert "| oracle (B. Other \\| " in told.out
    assert [path.read_text() for path in kept] == ["of mine", "of mine"]
    page = (tmp_path / "board" / "page" / "index.html").read_text()
    assert "A. Author, verified" in page
    assert "<C>" not in page
    assert "albedo" in (tmp_path / "board" / "page" / "parts" / "pictures.js").read_text()


def test_a_row_that_comes_in_two_packs_is_told_of_by_both(pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more = changed("metrics.json", lambda record: record.update(seed=1, declared={"seconds": 5.0}))
    second = spoiled(pack, tmp_path / "second.zip", more, hashed=True)
    assert main(["board", str(pack), second, "--out", str(tmp_path / "board")]) == 0
    (note,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("none (A. Author): ")]
    assert note.count("brought by A. Author") == 2
    assert "seconds as measured by the runs" in note
    assert note.endswith("seconds as they declare them")


def test_what_cannot_be_packed_is_said(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = shutil.copytree(runs / "none", tmp_path / "run")
    (run / "albedo.exr").write_bytes(b"")
    arguments = ["--out", str(tmp_path / "a.zip"), "--authors", "A. Author"]
    assert main(["pack", str(run), *arguments]) == 2
    assert "albedo.exr: expected the file that the run wrote, found another one" in capsys.readouterr().err
    assert main(["pack", str(runs / "none"), str(shutil.copytree(runs / "none", tmp_path / "twice")), *arguments]) == 2
    assert "expected one run of row none, scene tiny, seed 0, found a second one" in capsys.readouterr().err
    assert main(["pack", str(runs / "none"), "--out", str(tmp_path / "a.zip"), "--authors", " "]) == 2
    assert "authors: expected a name" in capsys.readouterr().err
    assert not (tmp_path / "a.zip").exists()


def test_what_others_made_is_scored_again_from_its_files(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(runs / "none"), "--pictures", str(tmp_path / "pictures")]) == 0
    (tmp_path / "pictures" / "albedo").rename(tmp_path / "elsewhere")
    (tmp_path / "pictures" / "albedo").symlink_to(tmp_path / "elsewhere")
    for name, what in (("pictures", tmp_path / "pictures"), ("asset", runs / "none" / "asset.glb")):
        given = f"--scene tiny --row {name} render.coat=added".split() + ["--seconds=77"] * (name == "asset")
        given += ["--out", str(tmp_path / "runs" / name), *SMALL[1:]]
        assert main(["score", str(what), *given]) == 0
        packed(tmp_path / "runs" / name, tmp_path / "packs" / f"{name}.zip", "C. Third")
    for folder in ("pictures", "elsewhere"):
        shutil.rmtree(tmp_path / folder)  # on another machine it is not there
    assert main(["verify", str(tmp_path / "packs")]) == 0
    assert "2 verified" in capsys.readouterr().out
    header = "protocol,row,scene,seed,status,reason,albedo_psnr"  # of a table that lies beside them, whose one cell failed
    (tmp_path / "packs" / "runs.csv").write_text(f"{header}\npaper-v3,none,tiny,0,failed,gone,\n")
    assert main(["verify", str(tmp_path / "packs")]) == 1
    assert "2 verified" in capsys.readouterr().out
    assert main(["board", str(tmp_path / "packs"), "--out", str(tmp_path / "board")]) == 0
    told = capsys.readouterr().out
    assert told.count("77.0 (declared)") == told.count("seconds as they declare them") == 1
    assert told.count("no seconds declared") == 1
