"""Priors, methods, readers and other plugins by name: built in, from entry points of other distributions, or as ``"module:Class"``.

A built-in plugin is one YAML file of ``conf/<group>/`` with a ``target``. Another distribution adds one with an entry
point in the group ``ia_bench.priors`` (likewise of methods, readers, couplings and regularisers):

    [project.entry-points."ia_bench.priors"]
    my_prior = "my_package.prior:MyPrior"

Nothing is imported before it is used, and every import is guarded: a plugin that raises is named and skipped, and is
an error only for the run that asked for it.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import random
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ia_bench.common.errors import Fault, InputError, PluginError, place_of, raised, unknown
from ia_bench.common.exit_codes import streams_kept
from ia_bench.common.files import hash_of_files, read_yaml
from ia_bench.common.paths import conf_folder
from ia_bench.common.settings import arguments_for

Kind = Literal["prior", "coupling", "regulariser", "method", "reader"]
KINDS: tuple[Kind, ...] = get_args(Kind)
BUILT_IN, THE_COMMAND_LINE = "ia_bench", "the command line"  # in place of a distribution
TESTS = "tests"  # a folder of a plugin's package, whose code decides no number
MEMBERS = {
    "prior": ("sample",),
    "coupling": ("prepare", "loss"),
    "regulariser": ("due", "apply"),
    "method": ("Options", "presets", "info", "fit"),
    "reader": ("read",),
}
"""What the class of a plugin must have, by kind; the contracts say what these are."""


class BrokenPlugin(InputError):
    """A plugin that is there and cannot be used: an error of the run that asked for it, and of no other."""


@dataclass(frozen=True)
class Plugin:
    """A name and where its class or function is: ``target`` is ``"module:attribute"``; ``options`` are those of its YAML file."""

    kind: Kind
    name: str
    target: str
    distribution: str
    options: Mapping[str, Any] = field(default_factory=dict, compare=False)


def installed(kind: Kind) -> dict[str, Plugin]:
    """Plugins that other distributions offer, by name. Reads their metadata and imports nothing.

    A name that is built in, or that two distributions claim, belongs to the first (built in, then alphabetical).
    """
    return _installed(kind, tuple(sys.path))


@cache  # a table asks for every cell
def _installed(kind: Kind, path: tuple[str, ...]) -> dict[str, Plugin]:
    found: dict[str, Plugin] = {}
    for entry in sorted(entry_points(group=f"ia_bench.{kind}s"), key=lambda e: (e.name, e.value)):
        if entry.name not in built_in(kind):
            distribution = f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown distribution"
            found.setdefault(entry.name, Plugin(kind, entry.name, entry.value, distribution))
    return found


@cache
def built_in(kind: Kind) -> Mapping[str, Plugin]:
    """Plugins that have a YAML file with a ``target`` in the configuration group of that kind, by name."""
    found = {}
    for path in sorted((conf_folder() / kind).glob("*.yaml")):
        content = read_yaml(path)
        own = content.get(kind, content)  # a file may set more than its group
        if own.get("target"):
            found[path.stem] = Plugin(kind, path.stem, str(own["target"]), BUILT_IN, own.get("options") or {})
    return found


def find(kind: Kind, name: str) -> Plugin:
    """The plugin called ``name``, or the one that ``name`` spells out as ``"module:attribute"``.

    Raises InputError naming the closest known name.
    """
    expect_no_path(kind, name)
    if ":" in name:
        return Plugin(kind, name, name, THE_COMMAND_LINE)
    known = {**built_in(kind), **installed(kind)}
    if name not in known:
        raise InputError(f"{unknown(kind, name, known)}, those of packages that are installed here, and module:Class")
    return known[name]


def expect_no_path(kind: Kind, name: str) -> None:
    """Raise InputError, saying how to write it, for a plugin that is named by its file."""
    module, _, attribute = name.partition(":")
    if os.sep in module or module.endswith(".py"):
        path = Path(module)
        raise InputError(
            f"{kind}={name}: expected a name or module:Class, found a path: PYTHONPATH={path.parent} makes it "
            f"{'' if kind == 'regulariser' else f'{kind}='}{path.stem}:{attribute or 'Class'}"
        )


def foreign_code(kind: Kind, name: str, target: str | None = None) -> str | None:
    """What tells one state of a plugin's code from another, None for a built-in one: its distribution and a hash of its modules.

    These are all modules of the top-level package that it belongs to, but for those in folders called ``tests``; or the one module
    that belongs to no package. What else it imports is told by the distribution's version alone. ``target``: None for the one
    that ``name`` stands for. Imports nothing.
    """
    plugin = named(kind, name, target)
    if plugin.distribution == BUILT_IN:
        return None
    hashes = [hash_of_files(root, files) for root, files in sources(plugin).items() if files]
    return f"{plugin.distribution}, {' '.join(hashes) or 'no file'}"


def sources(plugin: Plugin) -> dict[Path, list[Path]]:
    """The files that :func:`foreign_code` hashes, by the folder that each group of them lies in; none where it is built in.

    Raises InputError for a class of a notebook: nothing would tell a finished run from one of the class as it is by now.
    """
    if plugin.distribution == BUILT_IN:
        return {}
    module = plugin.target.partition(":")[0].split(".")
    try:
        found = importlib.util.find_spec(module[0])
    except (ImportError, ValueError):  # it has no name, or is no module of a file, as __main__
        found = None
    if found is None and module == ["__main__"]:
        path = Path(getattr(sys.modules["__main__"], "__file__", None) or "")
        if not path.is_file():
            raise InputError(
                f"{plugin.kind} {plugin.name}: expected a class in a file, by whose content its runs are known, found none"
            )
        return {path.parent: [path]}
    if found is None:
        return {}
    if found.submodule_search_locations is None:
        path = Path(found.origin or "")
        return {path.parent: [path]} if path.is_file() else {}
    left_out, groups = {TESTS} - set(module), {}
    for root in map(Path, found.submodule_search_locations):  # several of a package without __init__.py that lies in pieces
        below = [path for path in sorted(root.rglob("*.py")) if path.is_file()]  # an editor's lock is a link to nowhere
        groups[root] = [path for path in below if not left_out & set(path.relative_to(root).parts)]
    return groups


def named(kind: Kind, name: str, target: str | None) -> Plugin:
    """The plugin that a configuration names, with the distribution that offers it; ``target`` as of :func:`foreign_code`."""
    known = {**built_in(kind), **installed(kind)}.get(name)
    return known if known and target in (None, known.target) else Plugin(kind, name, target or name, THE_COMMAND_LINE)


def load(plugin: Plugin) -> Any:  # noqa: ANN401 (whatever the plugin's author put there)
    """Import what a plugin points to; what its modules change for the whole process, as scripts do, is put back.

    Raises BrokenPlugin with the plugin, its distribution and the cause in one line.
    """
    who = f"{plugin.kind} '{plugin.name}' of {plugin.distribution} cannot be used"
    module, separator, attribute = plugin.target.partition(":")
    if not (module and separator and attribute):
        raise InputError(f"{who}: expected a target 'module:Class', found '{plugin.target}'")
    try:
        with process_state_kept():
            found: Any = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:  # whatever foreign code does on import stays with that plugin
        absent = isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]
        where = "; it is looked for in the current folder and on PYTHONPATH" if absent else ""
        raise BrokenPlugin(f"{who}: importing {plugin.target} raised {raised(error)}{where}") from error
    members = MEMBERS[plugin.kind]
    lacking = [member for member in members if not hasattr(found, member)]
    if lacking or not callable(found):
        what = f"one without {', '.join(lacking)}" if isinstance(found, type) else f"an object of type {type(found).__name__}"
        raise BrokenPlugin(f"{who}: expected a class with {', '.join(members)}, found {what}")
    return found


def create(kind: Kind, name: str, target: str, options: Mapping[str, Any], *given: Any) -> Any:  # noqa: ANN401 (as load)
    """Import ``target`` and call it with what is ``given``, and ``options`` as keyword arguments.

    Raises InputError for a plugin that cannot be imported, for an option that its signature does not have or that lacks a
    value, naming the closest option, for a value that its annotation does not take, and for what is raised inside the call.
    """
    factory = load(named(kind, name, target))
    arguments_for(factory, options, f"{kind}.options", len(given))
    with at_work(kind, name):
        return factory(*given, **options)


@contextmanager
def at_work(kind: Kind, name: str) -> Iterator[None]:
    """Whatever a plugin raises inside the block, its sys.exit() too, becomes a PluginError that names it in one line.

    The exception itself is its cause, which IA_BENCH_DEBUG=1 shows. An InputError or a Fault, which say what is wrong, and an
    interruption by the user pass. What the plugin changed for the whole process is put back.
    """
    try:
        with process_state_kept():
            yield
    except (InputError, Fault, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise PluginError(f"{kind} {name} raised {told(error)}") from error


def told(error: BaseException) -> str:
    """What an exception of a plugin says, where it was raised, and how to see more."""
    where = f"{place}; " if (place := place_of(error)) else ""
    return f"{raised(error)} ({where}IA_BENCH_DEBUG=1 shows the traceback)"


@contextmanager
def process_state_kept() -> Iterator[None]:
    """Put back what the process had, however the block ends: random states, the folder, standard streams, defaults of torch.

    Where the block itself imports torch, that is put back to what it starts with.
    """
    states, errors = (random.getstate(), np.random.get_state()), np.geterr()
    folder = os.open(".", os.O_RDONLY)  # which may have no name any more
    torch = sys.modules.get("torch")
    if torch is not None:
        names = ("default_dtype", "num_threads", "default_device", "deterministic_debug_mode")
        kept = {name: getattr(torch, f"get_{name}")() for name in names}
        gradients, generator = torch.is_grad_enabled(), torch.get_rng_state()
    try:
        with streams_kept():
            yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])
        np.seterr(**errors)
        os.fchdir(folder)
        os.close(folder)
        if torch is not None:
            torch.set_grad_enabled(gradients)
            torch.set_rng_state(generator)
            for name, value in kept.items():
                if getattr(torch, f"get_{name}")() != value:
                    getattr(torch, f"set_{name}")(value)
        elif (fresh := sys.modules.get("torch")) is not None:
            fresh.set_default_dtype(fresh.float32)
            fresh.set_default_device(None)
            fresh.set_grad_enabled(True)
