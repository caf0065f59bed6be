"""Plugins of other distributions: found by metadata, imported on use, and unable to harm those that do not use them."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ia_bench.common import registry
from ia_bench.common.errors import InputError
from ia_bench.common.settings import arguments_for

GOOD = """
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

class Given:
    pass

class Sampler:
    def sample(self, observations, *, seed, guidance=None): ...

class Good(Sampler):
    def __init__(self, strength=1.0):
        self.strength = strength

class Typed(Sampler):
    def __init__(
        self,
        *,
        strength: "float" = 1.0,
        steps: int = 3,
        names: Iterable[str] = (),
        patches: bool | str = "auto",
        table: Mapping[str, Any] | None = None,
        rule: Literal["paper", "variance"] = "paper",
        sloppy: int = None,
        strange: [int] = 3,
        given: Given = (),
    ) -> None:
        pass

@dataclass(kw_only=True)
class Declared(Sampler):
    strength: float = 1.0

class Inheriting(Declared):
    def __init__(self, *, share: float, steps: int) -> None:
        super().__init__()

class Unresolved(Sampler):
    def __init__(self, steps: "Missing" = 3) -> None:
        pass
"""
ENTRY_POINTS = """
[ia_bench.priors]
good = third_good:Good
broken = third_broken:Thing
leaving = third_leaving:Thing
absent = third_nowhere:Thing
nameless = third_good:Nothing
none = third_good:Good
[ia_bench.readers]
blender = third_good:Good
"""


@pytest.fixture(autouse=True)
def third_party(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A distribution `third 1.2` with one good plugin and every kind of bad one."""
    (tmp_path / "third_good.py").write_text(GOOD)
    (tmp_path / "third_broken.py").write_text("raise ImportError('libfoo.so is missing\\nsecond line')")
    (tmp_path / "third_leaving.py").write_text("raise SystemExit(3)")
    info = tmp_path / "third-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name in [name for name in sys.modules if name.startswith("third_")]:
        del sys.modules[name]


def of_third(plugins: dict[str, registry.Plugin]) -> set[str]:
    """Names of those plugins that are of the distribution above: the baselines, which may be installed, bring others."""
    return {name for name, plugin in plugins.items() if plugin.distribution == "third 1.2"}


def test_listing_imports_nothing() -> None:
    before = set(sys.modules)  # of other tests' plugins too
    names = registry.installed("prior")
    assert of_third(names) == {"good", "broken", "leaving", "absent", "nameless"}
    assert names["good"] == registry.Plugin("prior", "good", "third_good:Good", "third 1.2")
    assert of_third(registry.installed("reader")) == {"blender"}
    assert not [name for name in set(sys.modules) - before if name.startswith("third_")]


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("broken", "ImportError: libfoo.so is missing$"),
        ("leaving", "SystemExit: 3"),
        ("absent", "ModuleNotFoundError: No module named 'third_nowhere'"),
        ("nameless", "AttributeError: .*'Nothing'"),
    ],
)
def test_broken_plugin_is_an_error_only_for_who_asks(name: str, cause: str) -> None:
    with pytest.raises(InputError, match=f"prior '{name}' of third 1.2 cannot be used: importing .* raised {cause}"):
        registry.load(registry.find("prior", name))


SCRIPT = """
import os
import random

import torch

torch.set_grad_enabled(False)
torch.set_default_dtype(torch.float64)
torch.set_default_device("meta")
random.seed(0)
os.chdir("/")


class Prior:
    def sample(self, observations, *, seed, guidance=None): ...
"""
STATE = "torch.is_grad_enabled(), torch.get_default_dtype(), torch.zeros(1).device, os.getcwd() == folder"


@pytest.mark.parametrize("first", ["import torch", "pass"])
def test_what_a_module_changes_when_it_is_imported_is_put_back(tmp_path: Path, first: str) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    code = f"""
import os, random
{first}
from ia_bench.common import registry
folder, drawn = os.getcwd(), random.getstate()
registry.load(registry.find("prior", "script:Prior"))
import torch
assert random.getstate() == drawn
print({STATE})
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "True torch.float32 cpu True\n"


def test_unknown_name_gives_the_closest_and_a_class_is_spelled_out() -> None:
    with pytest.raises(InputError, match=r"unknown prior 'orcale'; did you mean 'oracle'\? There are: .*good"):
        registry.find("prior", "orcale")
    made = registry.create("prior", "third_good:Good", "third_good:Good", {"strength": 2.0})
    assert made.strength == 2.0
    with pytest.raises(InputError, match="expected a target 'module:Class', found 'third_good:'"):
        registry.load(registry.find("prior", "third_good:"))


@pytest.mark.parametrize("kind", registry.KINDS)
def test_a_plugin_is_not_named_by_its_file(kind: registry.Kind) -> None:
    expected = rf"^{kind}=code/third_good\.py:Good: expected a name or module:Class, .* makes it ({kind}=)?third_good:Good$"
    with pytest.raises(InputError, match=expected):
        registry.find(kind, "code/third_good.py:Good")


def create_typed(**options: Any) -> Any:
    return registry.create("prior", "third_good:Typed", "third_good:Typed", options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strength": "a"}, "strength: expected a number, found 'a'"),
        ({"steps": "a"}, "steps: expected a whole number, found 'a'"),
        ({"steps": 3.5}, "steps: expected a whole number, found 3.5"),
        ({"names": ["albedo", 3]}, "names.1: expected text, found 3"),
        ({"patches": 1}, "patches: expected true or false or text, found 1"),
        ({"table": [1]}, r"table: expected a table, found \[1\]"),
        ({"rule": 1}, "rule: expected paper, variance, found 1"),
    ],
    ids=str,
)
def test_values_are_checked_against_annotations(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"^prior\.options\.{message}$"):
        create_typed(**options)


@pytest.mark.parametrize(
    ("kind", "target", "found"),
    [
        ("prior", "json:loads", "an object of type function"),
        ("prior", "os:system", "an object of type builtin_function_or_method"),
        ("method", "collections:OrderedDict", "one without Options, presets, info, fit"),
        ("reader", "math:pi", "an object of type float"),
    ],
)
def test_what_is_no_plugin_is_told_by_what_it_lacks(kind: registry.Kind, target: str, found: str) -> None:
    said = f"^{kind} .{target}. of the command line cannot be used: expected a class with .*, found {found}$"
    with pytest.raises(InputError, match=said):
        registry.load(registry.find(kind, target))


@pytest.mark.parametrize(
    ("target", "advice"), [("third_absent:Good", "; it is looked for in the current folder and on PYTHONPATH"), ("json:Good", "")]
)
def test_a_module_that_is_not_there_is_told_where_it_is_looked_for(target: str, advice: str) -> None:
    with pytest.raises(InputError, match=rf"importing {target} raised \w+: (No module named|module) .*'{advice}$"):
        registry.load(registry.find("prior", target))


def test_whatever_an_annotation_may_mean_is_let_through() -> None:
    create_typed(strength=2, names=["albedo"], patches=True, table={"a": 1}, rule="variance", sloppy=None)
    create_typed(patches="auto", table=None, strange="b", given="c")
    registry.create("prior", "third_good:Unresolved", "third_good:Unresolved", {"steps": "many"})


def test_an_option_may_have_any_name() -> None:
    """pydantic's models keep some for themselves: a warning, or no such setting."""

    def plugin(*, schema: int = 0, model_config: int = 0, _own: int = 0) -> None: ...

    arguments_for(plugin, {"schema": 1, "model_config": 2, "_own": 3}, "prior.options")
    with pytest.raises(InputError, match=r"prior\.options\._own: expected a whole number, found 'a'"):
        arguments_for(plugin, {"_own": "a"}, "prior.options")


# ---- the code of plugins ---------------------------------------------------------------------------------------------
PACKAGE = {
    "__init__.py": "from .prior import Good",
    "prior.py": GOOD,
    "method/__init__.py": "",
    "method/deep.py": GOOD,
    "common/__init__.py": "",
    "common/tool.py": "x = 1",
    "tests/test_it.py": "x = 1",
    "card.md": "a",
}


def package(folder: Path, *, left_out: tuple[str, ...] = ()) -> Path:
    """The package `third_package` in ``folder``: a class at its top, one deeper down, and code beside that both may use."""
    root = folder / "third_package"
    for name, content in PACKAGE.items():
        if name not in left_out:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(content)
    return root


@pytest.mark.parametrize("target", ["third_package:Good", "third_package.prior:Good", "third_package.method.deep:Good"])
@pytest.mark.parametrize("left_out", [(), tuple(name for name in PACKAGE if "__init__" in name)], ids=["package", "namespace"])
def test_the_code_of_a_plugin_is_that_of_its_whole_package(tmp_path: Path, target: str, left_out: tuple[str, ...]) -> None:
    root = package(tmp_path, left_out=left_out)
    code = registry.foreign_code("prior", target)
    assert code is not None
    for name in sorted(PACKAGE.keys() - set(left_out)):
        (root / name).write_text(PACKAGE[name] + "\n# another state of it")
        changed = registry.foreign_code("prior", target) != code
        assert changed == (name.endswith(".py") and not name.startswith("tests/")), name
        (root / name).write_text(PACKAGE[name])
        assert registry.foreign_code("prior", target) == code
    (root / "common/more.py").write_text("")
    assert registry.foreign_code("prior", target) != code, "a module that came later counts as well"
    assert "third_package" not in sys.modules, "nothing is imported to tell what code there is"


@pytest.mark.parametrize("target", ["third_nowhere:Good", "sys:path", ":Good"])
def test_code_without_a_file_is_told_by_its_distribution(target: str) -> None:
    assert registry.foreign_code("prior", target) == "the command line, no file"


def test_a_class_of_a_script_is_told_by_it_and_of_a_notebook_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "script.py"
    script.write_text(GOOD)
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", None)
    monkeypatch.setattr(sys.modules["__main__"], "__file__", str(script), raising=False)
    code = registry.foreign_code("prior", "__main__:Good")
    script.write_text(f"{GOOD}\n# another state of it")
    assert registry.foreign_code("prior", "__main__:Good") != code
    monkeypatch.delattr(sys.modules["__main__"], "__file__")
    with pytest.raises(InputError, match=r"^prior __main__:Good: expected a class in a file, .*, found none$"):
        registry.foreign_code("prior", "__main__:Good")


@pytest.mark.parametrize(
    ("target", "options", "message"),
    [
        ("Declared", {"strength": "x"}, "prior.options.strength: expected a number, found 'x'"),
        ("Inheriting", {"share": "x", "steps": 3}, "prior.options.share: expected a number, found 'x'"),
        ("Inheriting", {}, "prior.options: expected prior.options.share=..., prior.options.steps=..., found none"),
        ("Inheriting", {"shar": 1.0, "steps": 3}, "unknown setting 'prior.options.shar'; did you mean 'prior.options.share'?"),
        ("Inheriting", {"share": 1.0, "steps": 3, "strength": 1.0}, "unknown setting 'prior.options.strength'"),
    ],
)
def test_options_of_dataclasses_and_of_their_heirs_are_checked(target: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        registry.create("prior", f"third_good:{target}", f"third_good:{target}", options)
