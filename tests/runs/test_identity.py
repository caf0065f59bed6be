"""What identifies a run: every setting and file that decides a number, and nothing else."""

import dataclasses
import os
import shlex
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import pytest

from ia_bench.common.settings import parsed
from ia_bench.methods.two_stage.settings import FitSettings
from ia_bench.priors.diffusion import learned
from ia_bench.readers.writers.frames import write_nerfstudio
from ia_bench.runs import identity as identities
from ia_bench.runs.composition import compose
from ia_bench.runs.config import RunConfig, cell_name, slug
from ia_bench.runs.identity import from_anywhere, hash_of, identity, run_folder, setup
from ia_bench.scenes.scene import Scene

pytestmark = pytest.mark.usefixtures("scenes")


PRIORS = ("none", "diffusion", "ia_bench.priors.diffusion.prior:DiffusionPrior", "regressor", "refiner", "corrected")
FILES_READER = """
class Silent:
    def __init__(self, folder): self.folder = folder
    def read(self, truth): ...
class Says(Silent):
    def files(self): return [self.folder / "mine" / "0.png"]
"""


def _variations(settings):
    """The same settings with one leaf changed, for every leaf but those that decide no number."""
    found = []
    for leaf in dataclasses.fields(settings):
        value = getattr(settings, leaf.name)
        if dataclasses.is_dataclass(value):
            found += [dataclasses.replace(settings, **{leaf.name: changed}) for changed in _variations(value)]
        elif leaf.name not in ("regularise", "regulariser_options"):  # numbers and texts
            other = value + "x" if isinstance(value, str) else not value if isinstance(value, bool) else value + 1
            found.append(dataclasses.replace(settings, **{leaf.name: other}))
    return found


def config_hash(config: RunConfig) -> str:
    return hash_of(identity(config))


def hash_with(*overrides: str) -> str:
    return config_hash(compose(["device=cpu", *overrides]))


ALL_CORES = f"threads={len(os.sched_getaffinity(0))}"
SAME = f"out=elsewhere row=another preset=quick prior.cache=false fit.pixels=2048 {ALL_CORES}"
OTHERS = """seed=1 threads=63 capture.views=8 capture.geometry=hull capture.geometry=sdf scene=ship prior=oracle method=ceiling
    capture.white_balance=per_image
    reader.options.uv=xatlas preset=smoke protocol.lpips.net=alex protocol.ssim.sigma=2 protocol.samples_per_pixel=65
    render.shadows=none render.control_variate=false fit.rates.light=0.3"""


@pytest.mark.parametrize("override", SAME.split())
def test_hash_ignores_what_decides_no_number(override: str) -> None:
    assert hash_with(override) == hash_with()


@pytest.mark.parametrize("override", OTHERS.split())
def test_hash_changes_with_what_decides_numbers(override: str) -> None:
    assert hash_with(override) != hash_with()


def test_hash_changes_with_every_setting_of_fit_and_render(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identities, "method_of", lambda config: SimpleNamespace(Options=FitSettings))  # which refuses some of these
    config = compose(["device=cpu"])
    hashes = [config_hash(config)]
    for changed in _variations(config.render):
        hashes.append(config_hash(dataclasses.replace(config, render=changed)))
    for changed in _variations(FitSettings()):
        method = dataclasses.replace(config.method, options=dataclasses.asdict(changed))
        hashes.append(config_hash(dataclasses.replace(config, method=method)))
    assert len(hashes) > 30
    assert len(set(hashes)) == len(hashes)


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
    (scenes / "hat" / "images").symlink_to(elsewhere)
    linked = hash_with("scene=hat")
    (elsewhere / "again").symlink_to(elsewhere)  # which has no end
    assert hash_with("scene=hat") == linked
    (elsewhere / "0.exr").write_bytes(b"one")
    assert len({with_mesh, linked, hash_with("scene=hat")}) == 3


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


def test_a_mesh_of_any_format_counts_that_an_option_names(tmp_path: Path) -> None:
    (tmp_path / "photographs").mkdir()
    given = ["reader=nerfstudio", f"scene.path={tmp_path / 'photographs'}", f"reader.options.mesh={tmp_path / 'shape.stl'}"]
    (tmp_path / "shape.stl").write_bytes(b"one")
    before = hash_with(*given)
    (tmp_path / "shape.stl").write_bytes(b"other")
    assert hash_with(*given) != before
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "photographs" / "images").symlink_to(tmp_path / "elsewhere")
    given[-1] = given[-1].replace(".stl", ".gltf")
    (tmp_path / "shape.gltf").write_text('{"buffers": [{"uri": "its%20numbers.bin"}, {"uri": "data:"}]}')
    hashes = [before]
    for path in ("its numbers.bin", "elsewhere/0.png"):
        (tmp_path / path).write_bytes(b"one")
        hashes.append(hash_with(*given))
        (tmp_path / path).write_bytes(b"two")
        hashes.append(hash_with(*given))
    assert len(set(hashes)) == 5


def test_what_lies_where_a_setting_says_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = ["method=asset", "method.options.path=recovered/asset.glb"]
    Path("recovered").mkdir()
    Path("recovered", "asset.glb").write_bytes(b"one")
    before = hash_with(*given)
    assert f"'{tmp_path / 'recovered' / 'asset.glb'}'" in str(setup(compose(given))["config"])
    Path("recovered", "asset.glb").write_bytes(b"other")
    assert hash_with(*given) != before


def test_weights_are_the_prior_s_own_knowledge(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Packaged ones count however the prior is named, and behind another one; of two folders of weights each counts."""
    before = {name: hash_with(f"prior={name}") for name in PRIORS}
    monkeypatch.setattr(learned, "PACKAGED", tmp_path / "weights")
    for kind in ("diffusion", "regressor", "refiner"):
        (tmp_path / "weights" / kind).mkdir(parents=True)
        (tmp_path / "weights" / kind / "weights.safetensors").write_bytes(kind.encode())
    changed = {name: hash_with(f"prior={name}") for name in PRIORS}
    assert {name for name in PRIORS if changed[name] == before[name]} == {"none"}
    monkeypatch.chdir(tmp_path)
    one = hash_with("prior=refiner", "prior.options.refiner=weights")  # a folder that is named by one word
    assert one != changed["refiner"]
    assert setup(compose(["prior=refiner", "prior.options.refiner=weights"]))["config"]["prior"]["options"]["refiner"] == str(
        tmp_path / "weights"
    )
    (tmp_path / "weights" / "refiner" / "weights.safetensors").write_bytes(b"other")
    assert hash_with("prior=refiner", "prior.options.refiner=weights") != one


def test_a_reader_s_files_are_the_scene_s_and_no_others(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With a reader that says what it reads, what else lies below the folder counts for nothing; with another one all counts."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "files_reader.py").write_text(FILES_READER)
    folder = tmp_path / "captures"
    for name in ("mine", "theirs"):
        (folder / name).mkdir(parents=True)
        (folder / name / "0.png").write_bytes(name.encode())
    hashes: dict[str, list[str]] = {"Says": [], "Silent": []}
    for content in (b"1", b"2"):
        (folder / "theirs" / "0.png").write_bytes(content)
        for kind, found in hashes.items():
            found.append(hash_with(f"reader=files_reader:{kind}", f"scene.path={folder}"))
    assert hashes["Says"][0] == hashes["Says"][1]
    assert hashes["Silent"][0] != hashes["Silent"][1]


def test_what_lies_in_a_scene_s_folder_is_no_file_of_the_current_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tiny: Scene
) -> None:
    """masks/ of the command line is the folder of the scene, also where the current folder has one."""
    write_nerfstudio(tmp_path / "mine", tiny)
    (tmp_path / "elsewhere" / "masks").mkdir(parents=True)
    found = []
    for folder in (tmp_path, tmp_path / "mine", tmp_path / "elsewhere"):
        monkeypatch.chdir(folder)
        config = compose(["reader=nerfstudio", f"scene.path={tmp_path / 'mine'}", "reader.options.masks=masks/", "prior=none"])
        found.append(hash_of(identity(config)))
        assert setup(config)["config"]["reader"]["options"]["masks"] == "masks/"
    assert len(set(found)) == 1


def test_the_setup_holds_the_command_line_and_absolute_paths(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scenes: Path) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("model.safetensors", "uniform"):
        Path(name).write_bytes(b"one")
    named = {"reader.options.mesh": "model.safetensors", "reader.options.masks": "uniform", "more": [Path("model.safetensors")]}
    at = str(tmp_path / "model.safetensors")
    assert from_anywhere(named) == {"reader.options.mesh": at, "reader.options.masks": "uniform", "more": [at]}
    overrides = [f"scene.path={scenes / 'hat'}", "row='a b'", "protocol.lpips.weights=model.safetensors"]
    found = setup(compose(overrides))
    assert shlex.split(found["command"]) == ["ia-bench", "run", *overrides]
    assert found["config"]["protocol"]["lpips"]["weights"] == str(tmp_path / "model.safetensors")
    assert found["config"]["scene"]["path"] == str(scenes / "hat")
    assert parsed(RunConfig, found["config"]).row_name == "a b"


@pytest.mark.parametrize("prior", ["diffusion", "corrected"])
def test_the_precision_that_auto_means_is_part_of_the_hash(prior: str, monkeypatch: pytest.MonkeyPatch) -> None:
    hashes = []
    for fast in (True, False):
        monkeypatch.setattr(learned, "use_bf16", lambda *_, fast=fast: fast)
        hashes.append(hash_with(f"prior={prior}"))
    assert hashes[0] != hashes[1]


@pytest.mark.parametrize(
    "overrides",
    [("prior=mine:Mine",), ("method=mine:Mine",), ("reader=mine:Mine",), ("prior=corrected", "prior.options.of='mine:Mine'")],
)
def test_hash_follows_code_of_ones_own(overrides: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    body = """
        from ia_bench.methods.truth_seers import NoOptions
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


def test_hash_follows_the_code_of_the_coupling_that_a_prior_recommends(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Which may be of a third distribution; what no run takes counts for nothing."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "theirs-1.dist-info").mkdir()
    (tmp_path / "theirs-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1\n")
    (tmp_path / "theirs-1.dist-info" / "entry_points.txt").write_text("[ia_bench.couplings]\ntheirs = their_loss:Loss\n")
    prior = """
        from ia_bench.priors.contract import PriorInfo
        class Prior:
            info = PriorInfo(frozenset({"albedo"}), coupling="COUPLING")
            def sample(self, observations, *, seed, guidance=None): ...
    """
    for name in ("theirs", "targets"):
        (tmp_path / f"recommending_{name}.py").write_text(textwrap.dedent(prior).replace("COUPLING", name))
    hashes = []
    for version in (1, 2):
        (tmp_path / "their_loss.py").write_text(f"class Loss:\n    prepare = loss = print  # version {version}\n")
        of_theirs, of_ours = (f"prior=recommending_{name}:Prior" for name in ("theirs", "targets"))
        hashes.append([hash_with(of_theirs), hash_with(of_theirs, "coupling=kernel"), hash_with(of_ours), hash_with()])
    assert [first == second for first, second in zip(*hashes, strict=True)] == [False, True, True, True]


def test_folder_is_named_by_scene_row_and_hash() -> None:
    config = compose(["device=cpu", "prior=oracle", "row='oracle w/o guided'"])
    assert run_folder(config, "0123456789") == Path("runs", "hat", "oracle-w-o-guided-01234567")
    assert run_folder(compose(["device=cpu", "out=some/where"]), "") == Path("some/where")
    assert run_folder(compose(["device=cpu", "method=ceiling"]), "").name.startswith("ceiling-")
    assert slug("../x y") == "..-x-y"
    assert [cell_name(scene, "none", 0, "01234567") for scene in ("!", "..")] == ["_/none-seed0-01234567"] * 2
