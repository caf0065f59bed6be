"""Every shipped configuration composes, and the hash changes with what decides numbers and with nothing else."""

import dataclasses
import re
import shlex
from pathlib import Path
from types import UnionType
from typing import Annotated, Union, get_args, get_origin, get_type_hints

import pytest

from ia_bench.common.errors import InputError
from ia_bench.common.paths import conf_folder
from ia_bench.methods.couplings.kernel import Kernel
from ia_bench.methods.two_stage.settings import FitSettings, LearningRates, LossWeights
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.composition import compose, setting
from ia_bench.runs.config import CouplingConfig, SceneConfig, resolve_scene_folder
from ia_bench.runs.identity import identity
from ia_bench.scores.protocol import Protocol

pytestmark = pytest.mark.usefixtures("scenes")
GROUP_FILES = sorted(path for path in conf_folder().glob("*/*.yaml") if path.parent.name not in ("table", "regulariser"))


@pytest.mark.parametrize("path", GROUP_FILES, ids=lambda path: f"{path.parent.name}={path.stem}")
def test_shipped_choice_composes_and_says_how(path: Path, tmp_path: Path) -> None:
    commands = [line for line in path.read_text().splitlines()[:2] if line.startswith("# ia-bench run ")]
    assert len(commands) == 1, "opens with the command that uses it"
    words = shlex.split(commands[0].removeprefix("# ia-bench run "))
    overrides = [word for word in words if word != "device=cuda"]
    assert f"{path.parent.name}={path.stem}" in overrides
    given = (word.replace("=FOLDER", f"={tmp_path}").replace("=FILE", f"={tmp_path}") for word in overrides)
    chosen = getattr(compose([*given, "device=cpu"]), path.parent.name)
    name = chosen if isinstance(chosen, str) else chosen["name"] if isinstance(chosen, dict) else chosen.name
    assert name == path.stem


def test_quick_is_the_defaults_and_paper_is_the_paper() -> None:
    quick = compose(["device=cpu", "preset=quick"])
    assert (quick.method.options, quick.render) == (dataclasses.asdict(FitSettings()), RenderSettings())
    assert quick.protocol == Protocol()
    paper = compose(["device=cpu", "preset=paper"])
    assert (paper.render.texture, paper.render.light_height, paper.render.samples) == (2048, 256, 144)
    assert (paper.method.options["stage1_steps"], paper.method.options["stage2_steps"]) == (20_000, 15_000)


def test_fit_is_short_for_the_options_of_a_method_that_has_some() -> None:
    short, long = ("fit.weights.image=2", "fit.pixels=7"), ("method.options.weights.image=2", "method.options.pixels=7")
    config = compose(["device=cpu", *short])
    assert config == compose(["device=cpu", *long])
    assert (config.method.options["weights"]["image"], config.method.options["pixels"], config.fit) == (2.0, 7, None)
    assert config.method.options["rates"] == dataclasses.asdict(FitSettings().rates)
    assert compose(["device=cpu", "method=ceiling", *short]).method.options == {}  # so that a table may have a ceiling
    with pytest.raises(InputError, match="unknown setting 'method.options.pixels'"):
        compose(["device=cpu", "method=ceiling", "method.options.pixels=7"])


@pytest.mark.parametrize("kind", [FitSettings, LossWeights, LearningRates, RenderSettings])
def test_every_number_has_a_least_and_a_largest_value(kind: type) -> None:
    """Of a union, the branch that is a number."""
    for name, hint in get_type_hints(kind, include_extras=True).items():
        parts = [hint, *get_args(hint)] if get_origin(hint) is Union or isinstance(hint, UnionType) else [hint]
        for part in parts:
            if get_origin(part) is Annotated:
                bounds = " ".join(map(str, part.__metadata__[0].metadata))
                assert "Ge(" in bounds
                assert "Le(" in bounds
            else:
                assert part not in (int, float), name


@pytest.mark.parametrize("prior", ["oracle", "ia_bench.priors.contract:NoPrior"])
def test_views_and_coupling_of_any_prior_can_be_set(prior: str) -> None:
    """Also of one that is spelled out, whose node Hydra is told of only then."""
    config = compose(["device=cpu", f"prior={prior}", "prior.views=7", "coupling=kernel", "coupling.options.scale=0.2"])
    assert (config.prior.views, config.coupling.name) == (7, "kernel")
    assert config.coupling.options == dataclasses.asdict(Kernel(scale=0.2))
    assert compose(["device=cpu"]).coupling == CouplingConfig("auto")


def test_named_configurations_set_regularisers() -> None:
    """And leave the coupling to the default, as all priors do."""
    found = {name: compose(["device=cpu", f"prior={name}"]) for name in ("parsimony", "refiner", "combined")}
    regularisers = {name: config.method.options["regularise"] for name, config in found.items()}
    assert regularisers["combined"] == ["refiner", "parsimony", "context", "symmetry"]
    assert (regularisers["refiner"], regularisers["parsimony"]) == (["refiner"], ["parsimony"])
    assert {config.coupling.name for config in found.values()} == {"auto"}
    mine = compose(["device=cpu", "prior=combined", "fit.regularise=[symmetry]", "fit.regulariser_options.symmetry.amount=0.1"])
    assert mine.prior == found["combined"].prior
    assert (mine.method.options["regularise"], mine.row_name) == (["symmetry"], "combined")


def test_scenes_are_looked_for_in_several_folders_and_called_after_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("first/scenes/hat", "second/scenes/hat", "second/scenes/book"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.setenv("IA_BENCH_DATASETS", f"{tmp_path}/nothing:{tmp_path}/first:{tmp_path}/second")
    assert resolve_scene_folder(SceneConfig(name="hat")) == tmp_path / "first/scenes/hat"
    assert resolve_scene_folder(SceneConfig(name="book")) == tmp_path / "second/scenes/book"
    with pytest.raises(InputError, match=r"(?s)first/scenes or .*second/scenes:.*book"):
        resolve_scene_folder(SceneConfig(name="boook"))
    with pytest.raises(InputError, match="make scenes SCENES=drum"):
        resolve_scene_folder(SceneConfig(name="drum"))
    (tmp_path / "mug").mkdir()
    config = compose(["device=cpu", f"scene.path={tmp_path / 'mug'}"])
    assert config.scene.name == "mug"
    assert resolve_scene_folder(config.scene) == tmp_path / "mug"


@pytest.mark.parametrize("text", ["a\\", "a\\\\", "a\\'b", "a\\\\'b", "'", "it's", "\\'", "x, y: {1} [2] #=() \u00e9", ""])
def test_a_text_is_read_back_as_it_was_written(text: str) -> None:
    row = compose(["device=cpu", "scene=tiny", setting("row", f"r{text}")]).row_name
    assert row == f"r{text}"


def test_a_whole_number_is_the_same_setting_as_the_number() -> None:
    """Of a prior, of a regulariser and of the others."""
    for key, prior in (("prior.options.noise", "oracle"), ("fit.regulariser_options.context.view_count", "combined")):
        one, other = (compose(["device=cpu", "scene=tiny", f"prior={prior}", f"{key}={number}"]) for number in ("1", "1.0"))
        assert identity(one) == identity(other), key


@pytest.mark.parametrize("folder", ["tiny/", "./mine", "/tmp/mine", "../tiny"])
def test_a_folder_for_a_scene_is_told(folder: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"unknown scene '{folder}'") + r".* a folder is scene\.path=FOLDER$"):
        compose(["device=cpu", f"scene={folder}"])


def test_regularisers_are_a_list() -> None:
    with pytest.raises(InputError, match=r"regulariser=context: expected fit\.regularise=\[context\], a list of names"):
        compose(["device=cpu", "scene=tiny", "regulariser=context"])


def test_another_reader_needs_no_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Its scene is none of the shipped ones, whose name is there by default: it is called after its reader."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "their_package.py").write_text("class Read:\n    def __init__(self, path): ...\n    def read(self, truth): ...\n")
    config = compose(["device=cpu", "reader=their_package:Read"])
    assert config.scene.name == "their_package:Read"
    named = compose(["device=cpu", "reader=their_package:Read", "scene.name=mine"])  # as an entry of a table names it
    assert named.scene.name == "mine"
    assert resolve_scene_folder(config.scene, config.reader) is None
    assert identity(config)["scene"] == {"name": "their_package:Read", "content": None}


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ("fit.rates.albedo=1e30", r"fit.rates.albedo: expected 10 or less, found 1e\+30"),
        ("fit.weights.image=nan", "fit.weights.image: expected a finite number, found nan"),
        ("seed=9223372036854775808", "seed: expected less than 9223372036854775808, found 9223372036854775808"),
        ("prior=corrected prior.options.of_options={eta:nan}", "prior.options.of_options.eta: expected a finite number, found nan"),
        ("prior=oracle prior.options.components=[inf]", r"prior.options.components\[0\]: expected a finite number, found inf"),
        ("method=collections:OrderedDict", "method 'collections:OrderedDict' .* expected a class with Options, presets, info, fit"),
        ("fit.pixels=1000000000", "fit.pixels: expected to fit into the .* GB of memory that are free, found a need for"),
        ("render.texture=100000", "render.texture: expected to fit into the .* GB of memory that are free, found a need for"),
        ("coupling=json:loads", "coupling 'json:loads' .* expected a class with prepare, loss"),
        ("coupling=kernel coupling.options.scale=0", "coupling.options.scale: expected 1e-06 or more, found 0"),
        ("coupling.options.albedo=1", "coupling.options: expected none with coupling=auto"),
        ("fit.regularise=[parsimoni]", "unknown regulariser 'parsimoni'; did you mean 'parsimony'"),
        ("fit.regularise=[symmetry,symmetry]", "fit.regularise: expected each name once, found symmetry, symmetry"),
        ("fit.regulariser_options.symmetry.amount=1", "unknown regulariser in 'fit.regulariser_options.symmetry'"),
        (f"row={'b' * 201}", "row: expected a name of 1 to 200 printable characters, found"),
        (f"scene.name={'a' * 5000}", "scene.name: expected a name of 1 to 200 printable characters, found"),
        ("protocol.lpips.weights=no/such", "protocol.lpips.weights=no/such: no such file"),
        ("out=''", "out: expected some text, found ''"),
        ("scene=3", "unknown scene '3'. There are: "),
        ("+prior=true", "unknown prior 'true'. There are: "),
        ("method=ceiling prior=oracle", "prior=oracle: expected prior=none with method=ceiling, which asks no prior"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence_before_anything_starts(overrides: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}") as said:
        compose(["device=cpu", *overrides.split()])
    assert "\n" not in str(said.value)
