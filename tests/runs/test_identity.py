"""What identifies a run: every setting and file that decides a number, and nothing else."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import sys
import textwrap
from pathlib import Path

import pytest
from shipped_choices import _variations

from ia_bench.common.errors import InputError
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors import learned
from ia_bench.runs import identity as identities
from ia_bench.runs.checkpoint import BadCheckpoint, pack, unpack
from ia_bench.runs.composition import compose
from ia_bench.runs.config import slug
from ia_bench.runs.identity import config_hash, identity, run_folder

pytestmark = pytest.mark.usefixtures("scenes")


def hash_with(*overrides: str) -> str:
    return config_hash(compose(["device=cpu", *overrides]))


def test_hash_is_sha256_of_canonical_json() -> None:
    config = compose(["device=cpu"])
    text = json.dumps(identity(config), sort_keys=True, separators=(",", ":"))
    assert config_hash(config) == hashlib.sha256(text.encode()).hexdigest()


def test_a_scene_as_it_is_read_is_known_by_what_identified_it_before_there_were_captures() -> None:
    assert "capture" not in identity(compose(["device=cpu"]))
    assert identity(compose(["device=cpu", "capture.views=8"]))["capture"]["views"] == 8


@pytest.mark.parametrize(
    "overrides",
    [
        ("out=elsewhere",),
        ("row=another",),
        ("preset=quick",),
        ("fit.checkpoint_seconds=99",),
        ("prior.supervision.cache=false",),
        ("fit.pixels=2048",),
        (f"threads={len(os.sched_getaffinity(0))}",),
    ],
    ids=str,
)
def test_hash_ignores_what_decides_no_number(overrides: tuple[str, ...]) -> None:
    assert hash_with(*overrides) == hash_with()


def test_hash_ignores_how_an_sdf_is_made_where_there_is_none() -> None:
    assert hash_with("capture.sdf.cells=96") == hash_with()
    assert hash_with("capture.geometry=hull", "capture.sdf.cells=96") == hash_with("capture.geometry=hull")
    assert hash_with("capture.geometry=sdf", "capture.sdf.cells=96") != hash_with("capture.geometry=sdf")


def test_given_normals_count_by_their_content(tmp_path: Path) -> None:
    """Not by where they lie; without any, a run has the identity that it had before there could be some."""
    plain = identity(compose(["device=cpu", "capture.geometry=sdf"]))
    assert plain["capture"]["sdf"].keys() == {"cells", "steps", "seed"}
    assert hash_with("capture.geometry=sdf", "capture.sdf.align=true") != hash_with("capture.geometry=sdf")
    hashes = []
    for name, content in (("a", b"1"), ("b", b"1"), ("c", b"2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0000.npy").write_bytes(content)
        hashes.append(hash_with("capture.geometry=sdf", f"capture.sdf.normals={tmp_path / name}"))
    assert hashes[0] == hashes[1]
    assert len({*hashes, hash_with("capture.geometry=sdf")}) == 3
    with pytest.raises(InputError, match="capture.sdf.normals=nowhere: no such folder"):
        hash_with("capture.geometry=sdf", "capture.sdf.normals=nowhere")


@pytest.mark.parametrize(
    "override",
    [
        "seed=1",
        "threads=63",
        "capture.views=8",
        "capture.geometry=hull",
        "capture.geometry=sdf",
        "scene=ship",
        "prior=oracle",
        "method=ceiling",
        "reader.options.uv=xatlas",
        "preset=smoke",
        "protocol.lpips.net=alex",
        "protocol.ssim.sigma=2",
        "protocol.samples_per_pixel=65",
        "render.shadows=none",
        "fit.rates.light=0.3",
    ],
)
def test_hash_changes_with_what_decides_numbers(override: str) -> None:
    assert hash_with(override) != hash_with()


def test_hash_changes_with_every_setting_of_fit_and_render() -> None:
    config = compose(["device=cpu"])
    hashes = [config_hash(config)]
    for changed in _variations(config.render):
        hashes.append(config_hash(dataclasses.replace(config, render=changed)))
    for changed in _variations(FitSettings()):
        method = dataclasses.replace(config.method, options=dataclasses.asdict(changed))
        hashes.append(config_hash(dataclasses.replace(config, method=method)))
    assert len(hashes) > 30
    assert len(set(hashes)) == len(hashes)


def test_hash_changes_with_every_setting_of_supervision() -> None:
    config = compose(["device=cpu"])
    hashes = {config_hash(config)}
    varied = [s for s in _variations(config.prior.supervision) if s.cache]
    for changed in varied:
        hashes.add(config_hash(dataclasses.replace(config, prior=dataclasses.replace(config.prior, supervision=changed))))
    assert len(hashes) == len(varied) + 1 == len(dataclasses.fields(config.prior.supervision))


def test_hash_distinguishes_oracle_dials() -> None:
    assert hash_with("prior=oracle", "prior.options.noise=0.1") != hash_with("prior=oracle")


def test_hash_follows_the_scene_content_and_not_its_place(scenes: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere" / "hat"
    elsewhere.mkdir(parents=True)
    (elsewhere / "scene.json").write_bytes((scenes / "hat" / "scene.json").read_bytes())
    before = hash_with("scene=hat")
    assert hash_with(f"scene.path={elsewhere}") == before
    (scenes / "hat" / "mesh.ply").write_bytes(b"ply")
    with_mesh = hash_with("scene=hat")
    (scenes / "hat" / "mesh.ply").write_bytes(b"PLY")  # as long as before
    assert len({before, with_mesh, hash_with("scene=hat")}) == 3


def test_hash_follows_the_content_of_weights_and_not_their_place(tmp_path: Path) -> None:
    for name in ("here", "there"):
        (tmp_path / name / "unet").mkdir(parents=True)
        (tmp_path / name / "unet" / "weights.safetensors").write_bytes(b"one")
    option = f"prior.options.weights={tmp_path / 'here'}"
    before = hash_with("prior=diffusion", option)
    assert hash_with("prior=diffusion", f"prior.options.weights={tmp_path / 'there'}") == before
    assert hash_with("prior=diffusion") != before
    (tmp_path / "here" / "CARD.md").write_text("weights of mine")
    assert hash_with("prior=diffusion", option) == before
    (tmp_path / "here" / "unet" / "weights.safetensors").write_bytes(b"other")
    assert hash_with("prior=diffusion", option) != before
    nested = [f"prior.options.of_options={{weights: {tmp_path / name}}}" for name in ("here", "there")]
    assert hash_with("prior=corrected", nested[0]) != hash_with("prior=corrected", nested[1])


def test_hash_follows_the_refiners_weights_beside_those_of_its_regressor(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Packaged ones where only the regressor's are given, and a folder of the current one that is named by one word."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(identities, "PACKAGED_WEIGHTS", tmp_path / "packaged")
    hashes: dict[str, list[str]] = {"weights": [], "refiner": [], "both": []}
    for content in (b"one", b"other"):
        for name, held in (("packaged", content), ("named", content), ("constant", b"")):
            (tmp_path / name).mkdir(exist_ok=True)
            (tmp_path / name / "weights.safetensors").write_bytes(held)
        given = {"weights": ("weights=constant",), "refiner": ("weights=constant", "refiner=named")}
        for which, options in {**given, "both": ("weights=constant", "refiner=constant")}.items():
            hashes[which].append(hash_with("prior=refiner", *(f"prior.options.{option}" for option in options)))
    assert {which: one == other for which, (one, other) in hashes.items()} == {"weights": False, "refiner": False, "both": True}


@pytest.mark.parametrize("prior", ["diffusion", "corrected"])
def test_the_precision_that_auto_means_is_part_of_the_hash(prior: str, monkeypatch: pytest.MonkeyPatch) -> None:
    hashes = []
    for fast in (True, False):
        monkeypatch.setattr(learned, "use_bf16", lambda *_, fast=fast: fast)
        hashes.append(hash_with(f"prior={prior}"))
    assert hashes[0] != hashes[1]


def test_hash_follows_files_named_without_a_folder_or_in_a_list(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    found = []
    for content in (b"one", b"other"):
        (tmp_path / "model.pt").write_bytes(content)
        options = {"checkpoint": "model.pt", "list": ["./model.pt", 3], "word": "model", "empty": "", "long": "x" * 5000}
        found.append(identities._without_paths("options", options))
    one, other = found
    assert one["checkpoint"] == one["list"][0] != other["checkpoint"]
    assert other["checkpoint"] == other["list"][0]
    assert all(each["checkpoint"].startswith("content ") for each in found)
    assert [{**one, "checkpoint": 0, "list": 0}, one["list"][1]] == [{**options, "checkpoint": 0, "list": 0}, 3]


def test_what_the_hash_stands_for_is_kept_beside_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scenes: Path) -> None:
    """Every path absolute, and none of a word that a file is called like by chance."""
    monkeypatch.chdir(tmp_path)
    for name in ("model.safetensors", "given", "uniform"):
        Path(name).write_bytes(b"one")
    overrides = [f"scene.path={scenes / 'hat'}", "prior=corrected", "prior.options.of_options={weights: given}", "capture=phone"]
    config = compose(["device=cpu", *overrides, "protocol.lpips.weights=model.safetensors"])
    assert identities.given(config) == {
        "scene.path": str(scenes / "hat"),
        "capture.name": "phone",
        "prior.options.of_options.weights": str(tmp_path / "given"),
        "protocol.lpips.weights": str(tmp_path / "model.safetensors"),
    }
    options = {"list": ["./uniform", 3], "word": "uniform"}
    assert identities._paths_in("method.options", options) == {"method.options.list.0": str(tmp_path / "uniform")}
    assert identities._without_paths("options", options)["word"] == "uniform"
    assert identities.given(compose(["device=cpu", "scene=hat"])) == {}


def test_packaged_weights_are_part_of_the_hash(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    before = {name: hash_with(f"prior={name}") for name in ("none", "diffusion", "corrected")}
    (tmp_path / "weights").write_bytes(b"others")
    monkeypatch.setattr(identities, "PACKAGED_WEIGHTS", tmp_path)
    after = {name: hash_with(f"prior={name}") for name in before}
    assert {name: after[name] == before[name] for name in before} == {"none": True, "diffusion": False, "corrected": False}


@pytest.mark.parametrize(
    "overrides",
    [("prior=mine:Mine",), ("method=mine:Mine",), ("reader=mine:Mine",), ("prior=corrected", "prior.options.of='mine:Mine'")],
)
def test_hash_follows_the_code_of_what_is_not_built_in(
    overrides: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    body = """
        from ia_bench.methods.ceiling import NoOptions
        from ia_bench.methods.info import MethodInfo
        class Mine:
            Options, presets, info, value = NoOptions, {}, MethodInfo(uses_prior=True), 1
            def __init__(self, options=None): ...
            def read(self, truth): ...
            sample = fit = read
    """
    (tmp_path / "mine.py").write_text(textwrap.dedent(body))
    before = hash_with(*overrides)
    assert hash_with(*overrides) == before
    (tmp_path / "mine.py").write_text(textwrap.dedent(body).replace("), 1", "), 2"))
    assert hash_with(*overrides) != before


def test_no_checkpoint_is_resumed_by_other_code_that_a_plugin_shares(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    body = """
        from ia_bench.methods.ceiling import NoOptions
        from ia_bench.methods.info import MethodInfo
        class Ours:
            Options, presets, info = NoOptions, {}, MethodInfo(uses_prior=False)
            def __init__(self, options): ...
            def fit(self, problem, *, seed, monitor): ...
    """
    parts = {"one/method": textwrap.dedent(body), "common/steps": "RATE = 1"}
    for name, content in (parts | dict.fromkeys(["__init__", "one/__init__", "common/__init__"], "")).items():
        path = tmp_path / "shares_code" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    file = tmp_path / "checkpoint.pt"
    file.write_bytes(pack({"step": 3}, hash_with("method=shares_code.one.method:Ours"))[0])
    assert unpack(file, hash_with("method=shares_code.one.method:Ours")) == {"step": 3}
    (tmp_path / "shares_code/common/steps.py").write_text("RATE = 10")
    with pytest.raises(BadCheckpoint, match="another configuration"):
        unpack(file, hash_with("method=shares_code.one.method:Ours"))


def test_hash_follows_the_content_of_lpips_weights_and_not_their_place(tmp_path: Path) -> None:
    hashes = [hash_with()]  # LPIPS from the package's cache, or undefined: giving the weights later is another run
    for name, content in (("a", b"weights"), ("b", b"weights"), ("c", b"others")):
        path = tmp_path / f"{name}.safetensors"
        path.write_bytes(content)
        hashes.append(hash_with(f"protocol.lpips.weights={path}"))
    assert hashes[1] == hashes[2]
    assert len({*hashes}) == 3


def test_folder_is_named_by_scene_row_and_hash() -> None:
    config = compose(["device=cpu", "prior=oracle", "row='oracle w/o guided'"])
    assert run_folder(config) == Path("runs", "hat", f"oracle-w-o-guided-{config_hash(config)[:8]}")
    assert run_folder(compose(["device=cpu", "out=some/where"])) == Path("some/where")
    assert run_folder(compose(["device=cpu", "method=ceiling"])).name.startswith("ceiling-")
    assert slug("../x y") == "..-x-y"
