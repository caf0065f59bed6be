"""What one run is made of, checked by name, type and range, and completed for this machine."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from ia_bench.capture.settings import CaptureSettings
from ia_bench.common import registry
from ia_bench.common.errors import Fault, InputError, printable, unknown
from ia_bench.common.files import user_path
from ia_bench.common.machine import cores, expect_memory
from ia_bench.common.paths import MORE_SCENES, PACKAGE, SCENES_VARIABLE, conf_folder, scenes_folders
from ia_bench.common.ranges import NO_NUMBER, Name, NameIfAny, NumberOrAuto
from ia_bench.common.settings import arguments_for, defaults_of, merged, parsed, parsed_file
from ia_bench.methods.info import AUTO, check_declarations
from ia_bench.render.settings import RenderSettings
from ia_bench.runs.record import CONFIG, RunSetup
from ia_bench.scores.protocol import Protocol

NATIVE_READER = "ia_bench.readers.native:NativeReader"
DEFAULT_METHOD = "two_stage"  # of conf/config.yaml


@dataclass(frozen=True)
class SceneConfig:
    """A scene: ``path`` is the folder that the reader is given, None for the shipped scene ``name``."""

    name: NameIfAny = ""
    path: str | None = None


@dataclass(frozen=True)
class PluginConfig:
    """A plugin: the class ``target`` (``"module:Class"``) called with ``options``, a reader with the scene's folder before them.

    The options of a method, whose ``Options`` say what they may be, are complete in a resolved configuration: those of the command
    line over those of the preset over the defaults.
    """

    name: str
    target: str
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ReaderConfig(PluginConfig):
    """A reader of scenes."""

    name: str = "native"
    target: str = NATIVE_READER


@dataclass(frozen=True)
class PriorConfig(PluginConfig):
    """A prior.

    Attributes:
        views: How many training views it is asked about, evenly spread, "all", or "auto": as many as show the surface often enough.
        cache: Whether its unguided samples are kept between runs, if it has a fingerprint. Decides no number.
    """

    views: NumberOrAuto | Literal["all"] = "auto"
    cache: bool = field(default=True, metadata=NO_NUMBER)


@dataclass(frozen=True)
class CouplingConfig:
    """How a method uses what the prior says: the class ``target`` called with ``options``; "auto" is what the prior recommends."""

    name: str = AUTO
    target: str | None = None
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class RunConfig:
    """One cell of a table. ``conf/config.yaml`` composes it; every field can be overridden on the command line.

    Attributes:
        scene: What is reconstructed.
        reader: The format of its files.
        capture: What is left out of the scene before anything is fitted.
        prior: What is known beforehand.
        coupling: How it is used.
        method: Who reconstructs.
        fit: Short form of ``method.options``, over which it goes; a method without options ignores it. None once resolved.
        preset: How much work: render and protocol settings of ``conf/preset``, and what the method makes of the name.
        protocol: How results are scored.
        render: The renderer.
        seed: Every random draw depends on it.
        device: "auto", "cpu" or "cuda".
        threads: CPU threads, None for all that this process may use.
        row: Label in tables, None for the prior's or the method's name.
        out: The run's folder, None for ``runs/<scene>/<row>-<hash>``.
        command: The overrides that it was composed of, as they were given.
    """

    scene: SceneConfig
    reader: ReaderConfig
    prior: PriorConfig
    method: PluginConfig
    preset: str
    protocol: Protocol
    coupling: CouplingConfig = field(default_factory=CouplingConfig)
    capture: CaptureSettings = field(default_factory=CaptureSettings)
    render: RenderSettings = field(default_factory=RenderSettings)
    fit: dict[str, Any] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    device: Literal["auto", "cpu", "cuda"] = "auto"
    threads: Annotated[int, Field(ge=1)] | None = None
    row: Name | None = None
    out: Annotated[str, Field(min_length=1)] | None = None
    command: tuple[str, ...] = field(default=(), compare=False)

    @property
    def row_name(self) -> str:
        """Label in tables and folder names: ``row``, or what distinguishes this run: its method, its prior, its capture."""
        if self.row is not None:
            return self.row
        method = self.method.name if self.method.name != DEFAULT_METHOD else ""
        prior = self.prior.name if not method or self.prior.name != "none" else ""
        return ", ".join(filter(None, (method, prior, self.capture.label)))


def resolved(content: Mapping[str, Any], here: bool = True) -> RunConfig:
    """The run that ``content``, JSON types, describes, with everything filled in that depends on this machine.

    Nothing is allocated or started yet. A run that is not to be started ``here`` is not measured against this machine: it may
    ask for more memory and for CUDA; ``device=auto`` is the CPU then. A resolved configuration is its own resolution.

    Raises InputError for what is no such setting, for a value that its setting cannot take,
    for a plugin that is none, and for what this machine has not got.
    """
    config = parsed(RunConfig, content)
    device = _device(config.device, here)
    scene, reader = config.scene, config.reader
    if scene.path is not None:
        if scene.path.startswith(REAL_DATA) and not Path(REAL_DATA).exists():
            raise InputError(f"scene.path={scene.path}: expected real data, found none; make real-data puts it there")
        scene = replace(scene, path=str(user_path("scene.path", scene.path, folder=True)))
    elif reader.target != NATIVE_READER and not scene.name:
        scene = replace(scene, name=reader.name)
    if config.protocol.lpips.weights is not None:
        user_path("protocol.lpips.weights", config.protocol.lpips.weights)  # a run would find out after its fit
    kind = registry.load(registry.named("reader", reader.name, reader.target))
    given = arguments_for(kind, reader.options, "reader.options", 1)
    options = {key: list(value) if isinstance(value, tuple) else value for key, value in defaults_of(kind, 1).items()}
    reader = replace(reader, options=options | given)
    if scene.path is not None and not scene.name:  # some readers know a better name than that of the folder
        made: object = None
        with suppress(InputError, Fault):  # a folder that is none of its format: told when the scene is read
            made = registry.create("reader", reader.name, reader.target, reader.options, Path(scene.path))
        scene = replace(scene, name=printable(getattr(made, "label", Path(scene.path).name)))
    return replace(
        config,
        scene=scene,
        reader=reader,
        prior=_prior(config.prior, device),
        coupling=_coupling(config.coupling),
        method=_method(config, here),
        fit=None,
        device=device,
        threads=config.threads or cores(),
    )


def method_class(method: PluginConfig) -> Any:  # noqa: ANN401 (a Method, whose contract imports torch)
    """The class of a method. Raises InputError for one that cannot be used, PluginError for one that declares something else."""
    kind = registry.load(registry.named("method", method.name, method.target))
    check_declarations(method.name, kind)
    return kind


def method_of(config: RunConfig) -> Any:  # noqa: ANN401 (a Method, whose contract imports torch)
    """The method of a resolved run, made with its options."""
    kind = method_class(config.method)
    options = parsed(kind.Options, config.method.options, "method.options")
    with registry.at_work("method", config.method.name):
        return kind(options)


REAL_DATA = "results/real/"  # where conf/table/captures.yaml looks for what is not shipped


def resolve_scene_folder(scene: SceneConfig, reader: ReaderConfig | None = None) -> Path | None:
    """Folder of the scene's files, None for another ``reader`` than the native one that was given no ``scene.path``.

    Raises InputError naming the closest scene, or the two ways to say where scenes are.
    """
    if scene.path is not None:
        return user_path("scene.path", scene.path, folder=True)
    if reader is not None and reader.target != NATIVE_READER:
        return None
    roots = scenes_folders()
    for root in roots:
        if (root / scene.name).is_dir():
            return root / scene.name
    there = sorted({folder.name for root in roots for folder in root.iterdir() if folder.is_dir()})
    message = unknown(f"scene in {' or '.join(map(str, roots))}:", scene.name, there)
    if roots[0].is_relative_to(PACKAGE):
        message += f". {MORE_SCENES}"
    elif (conf_folder() / "scene" / f"{scene.name}.yaml").is_file():
        message += f". It has a recipe: make scenes SCENES={scene.name}, then {SCENES_VARIABLE}=results/datasets"
    raise InputError(message)


def expect_outside(key: str, place: Path, scene: SceneConfig, reader: ReaderConfig) -> None:
    """Raise InputError, naming ``key``, for a ``place`` in the scene's folder, whose content is part of a run's identity."""
    folder = resolve_scene_folder(scene, reader)
    if folder is not None and Path(os.path.realpath(place)).is_relative_to(os.path.realpath(folder)):
        raise InputError(f"{key}={place}: expected a place outside of the scene's folder, found one in {folder}")


def slug(text: str) -> str:
    """A label as a folder name: ``oracle w/o guided`` becomes ``oracle-w-o-guided``; "_" for one without a letter or number."""
    words = "-".join("".join(c if c.isalnum() or c in "_." else " " for c in text).split())
    return words if words.strip(".") else "_"  # no letter at all: a path with "" or ".." as a part leads elsewhere


def cell_name(scene: str, row: str, seed: int, key: str) -> str:
    """The folder of one of many runs, ``hat/oracle-w-o-guided-seed0-0123abcd``; ``key``: the hash of its identity."""
    return f"{slug(scene)}/{slug(row)}-seed{seed}-{key[:8]}"


def config_of(folder: Path) -> RunConfig:
    """The configuration of the run in a folder. Raises InputError where there is none, or something else."""
    return parsed_file(RunConfig, folder / CONFIG, RunSetup.read(folder).config, "config: ")


def _prior(prior: PriorConfig, device: str) -> PriorConfig:
    """The prior with its options checked against its class, and made explicit where they depend on this machine."""
    kind = registry.load(registry.named("prior", prior.name, prior.target))
    prior = replace(prior, options=arguments_for(kind, prior.options, "prior.options"))
    resolve = getattr(kind, "resolved_options", None)
    if resolve is None:
        return prior
    from ia_bench.priors.inputs import beside_run  # brings in torch, as do all that have something to resolve

    with beside_run(device):
        return replace(prior, options=resolve(prior.options))


def _coupling(coupling: CouplingConfig) -> CouplingConfig:
    """The coupling with all its options, if it is one of the classes that say which they have."""
    if coupling.name == AUTO:
        if coupling.options:
            raise InputError(
                f"coupling.options: expected none with coupling={AUTO}, which leaves the choice to the prior, found "
                f"{', '.join(coupling.options)}; name the coupling, as coupling=targets"
            )
        return coupling
    kind: type = registry.load(registry.named("coupling", coupling.name, coupling.target))
    if is_dataclass(kind):
        return replace(coupling, options=asdict(parsed(kind, coupling.options, "coupling.options")))
    return replace(coupling, options=arguments_for(kind, coupling.options, "coupling.options"))


def _method(config: RunConfig, here: bool) -> PluginConfig:
    """The method with all its options, those of the preset among them."""
    method = config.method
    kind = method_class(method)
    key = "method.options" if config.fit is None else "fit"
    given = merged(kind.presets.get(config.preset, {}), method.options)
    options = parsed(kind.Options, merged(given, config.fit or {}) if fields(kind.Options) else given, key)
    demand = {f"render.{name}": size for name, size in config.render.memory().items()}
    if hasattr(options, "memory"):
        demand |= {f"{key}.{name}": size for name, size in options.memory(config.render).items()}
    for name, size in demand.items() if here else ():
        expect_memory(name, size)
    if not kind.info.uses_prior and config.prior.name != "none":
        raise InputError(f"prior={config.prior.name}: expected prior=none with method={method.name}, which asks no prior")
    return replace(method, options=asdict(options))


def _device(wanted: str, here: bool) -> Literal["cpu", "cuda"]:
    if wanted == "cpu" or not here:
        return "cuda" if wanted == "cuda" else "cpu"
    import torch  # takes a second or two; a run on the CPU by choice can be told apart without it

    if wanted == "cuda" and not torch.cuda.is_available():
        raise InputError("device=cuda: torch finds no CUDA device here; use device=cpu or device=auto")
    return "cuda" if torch.cuda.is_available() else "cpu"
