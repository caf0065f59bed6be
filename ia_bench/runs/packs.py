"""A pack: finished runs as one zip file that others can score again and show beside theirs.

``manifest.json`` says who brings it and what is in it; each run lies in a folder of its own, with its record, its configuration and
every file that it wrote. What is read of a pack is somebody else's: names that lead elsewhere and sizes beyond reason are refused.
"""

from __future__ import annotations

import hashlib
import shutil
import stat
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import Field

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import InputError
from ia_bench.common.files import read_json, shown, user_path
from ia_bench.common.ranges import Name
from ia_bench.common.registry import THE_COMMAND_LINE, named
from ia_bench.common.settings import parsed
from ia_bench.runs.config import NATIVE_READER, slug
from ia_bench.runs.record import CONFIG, METRICS_FILE, RunRecord, RunSetup, damaged_file, digest_of, json_bytes

MANIFEST = "manifest.json"
FORMAT: Literal[1] = 1
ORDERS, PICTURES = ("names", "sorted"), (".exr", ".png")  # as method=images has them
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file within: the same runs give the same bytes
BROUGHT_PICTURES, ORDER = "brought", "order.json"
"""The folder below a run's with the pictures that method=images scored, and the file in it that says their order."""
MOST_MEMBERS, MEMBER_BYTES, ALL_BYTES = 20_000, 1 << 30, 8 << 30
"""Of files in a pack: how many, and how many bytes of one and of all, unpacked."""
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError)
"""What zipfile raises for a file that is none, is cut off, encrypted, or packed in a way that it does not know."""


@dataclass(frozen=True, kw_only=True)
class PackedRun:
    """One run of a pack.

    Attributes:
        folder: Where in the pack its files lie.
        row: As in its record, like the next five.
        scene: Name of the scene.
        seed: Of everything that is drawn.
        status: "ok" or "failed".
        protocol: The protocol's label.
        protocol_hash: SHA-256 of the protocol and the content of the scene's files.
        config_hash: SHA-256 of the run's identity.
        scene_content: SHA-256 of the files of the scene; None where the reader names none.
        files: Name of a file in the folder -> its SHA-256.
    """

    folder: str
    row: Name
    scene: Name
    seed: int
    status: Literal["ok", "failed"]
    protocol: str
    protocol_hash: str | None
    config_hash: str
    scene_content: str | None
    files: dict[str, str]

    @classmethod
    def of(cls, folder: Path, place: str) -> PackedRun:
        """The run in ``folder``, which lies at ``place`` in the pack. Raises InputError where it has no record."""
        try:
            record, setup = RunRecord.read(folder), RunSetup.read(folder)
        except FileNotFoundError:
            raise InputError(f"{folder}: expected a run's {METRICS_FILE}, found none") from None
        names = ("row", "scene", "seed", "status", "protocol", "protocol_hash", "config_hash")
        labels = {name: getattr(record, name) for name in names}
        scene = setup.identity.get("scene")
        files = {file: digest_of(folder / file) or "" for file in (METRICS_FILE, CONFIG, *record.files)}
        return cls(folder=place, scene_content=scene.get("content") if isinstance(scene, dict) else None, files=files, **labels)


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """What a pack says of itself.

    Attributes:
        authors: Who brings it, as they declare it.
        url: Where more is said of it.
        note: What a reader has to know.
        runs: What is in it.
        format: Version of this layout.
    """

    authors: Name
    url: str = ""
    note: str = ""
    runs: Annotated[list[PackedRun], Field(min_length=1)]
    format: Literal[1] = FORMAT


def write_pack(folders: Sequence[Path], out: Path, *, authors: str, url: str = "", note: str = "") -> Manifest:
    """Write the runs in ``folders`` into the zip file ``out`` and return its manifest; the same runs give the same bytes.

    Nothing is taken from the environment, and the name of the home folder is taken out of the configurations' paths.
    Raises InputError for a run that lacks a file or whose file was changed, and for two runs of one row, scene and seed.
    """
    runs: list[PackedRun] = []
    content: dict[str, bytes | Path] = {}
    parts: dict[str, bytes | Path]
    for folder in folders:
        run = PackedRun.of(folder, "")
        damaged = damaged_file(folder, RunRecord.read(folder))
        if damaged is not None:
            raise InputError(f"{folder / damaged}: expected the file that the run wrote, found {_instead(folder / damaged)}")
        name = f"runs/{slug(run.scene)}/{slug(run.row)}-seed{run.seed}-{run.config_hash[:8]}"
        twice = next((other for other in runs if (other.row, other.scene, other.seed) == (run.row, run.scene, run.seed)), None)
        if twice is not None:
            raise InputError(f"{folder}: expected one run of row {run.row}, scene {run.scene}, seed {run.seed}, found a second one")
        texts = {file: _without_home((folder / file).read_bytes()) for file in (METRICS_FILE, CONFIG)}
        parts = {**{file: folder / file for file in run.files}, **_brought(folder), **texts}
        content |= {f"{name}/{file}": part for file, part in parts.items()}
        digests = {
            file: digest_of(part) if isinstance(part, Path) else hashlib.sha256(part).hexdigest() for file, part in parts.items()
        }
        runs.append(PackedRun(**{**asdict(run), "folder": name, "files": digests}))
    manifest = parsed(Manifest, asdict(Manifest(authors=authors, url=url, note=note, runs=runs)))
    with whole_file(out) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, part in {MANIFEST: json_bytes(MANIFEST, asdict(manifest)), **content}.items():
            data = part if isinstance(part, bytes) else part.read_bytes()
            archive.writestr(zipfile.ZipInfo(name, EPOCH), data, zipfile.ZIP_DEFLATED)
    return manifest


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The zip file ``path``, of which every member has a name below its folder and a size within reason. Raises InputError."""
    try:
        with zipfile.ZipFile(path) as archive:
            _check_members(path, archive.infolist())
            yield archive
    except BROKEN as error:
        raise InputError(f"{shown(path)}: expected a pack, found no readable zip file ({shown(error)})") from None


def unpack(path: Path, out: Path) -> Manifest:
    """Unpack what the manifest of the pack ``path`` lists into the folder ``out``, and return the manifest.

    Hashes are not asked about (:func:`problems`). Raises InputError for a file that is no pack, is damaged, lacks a file or has
    one that its manifest does not list, or whose names lead out of its folder.
    """
    with opened(path) as archive:
        names = {info.filename for info in archive.infolist() if not info.is_dir()}
        if MANIFEST not in names:
            raise InputError(f"{path}: expected a {MANIFEST} in the pack, found none")
        _extract(archive, MANIFEST, out)
        try:
            manifest = parsed(Manifest, read_json(out / MANIFEST))
        except InputError as error:
            raise InputError(f"{path}: {MANIFEST}: {str(error).removeprefix(f'{out / MANIFEST}: ')}") from None
        listed = [f"{run.folder}/{file}" for run in manifest.runs for file in run.files]
        for what, odd in (("lists", set(listed) - names), ("does not list", names - {*listed, MANIFEST})):
            if odd:
                found = "which is not there" if what == "lists" else "in the pack"
                raise InputError(f"{path}: {MANIFEST} {what} {shown(sorted(odd)[0])}, {found}")
        if len(set(listed)) < len(listed):
            raise InputError(f"{path}: {MANIFEST}: expected a folder of its own for every run, found one twice")
        for name in listed:
            _extract(archive, name, out)
    return manifest


def problems(run: PackedRun, out: Path) -> list[str]:
    """What of an unpacked run is not as its manifest or its own record says; nothing where all agree."""
    folder = out / run.folder
    try:
        found = PackedRun.of(folder, run.folder)
    except InputError as error:
        return [str(error).replace(f"{folder}/", "").replace(str(folder), run.folder)]
    said = [
        f"{name}: the manifest says {shown(repr(value))}, the run's files say {shown(repr(getattr(found, name)))}"
        for name, value in asdict(run).items()
        if name != "files" and getattr(found, name) != value
    ]
    recorded = {**found.files, **RunRecord.read(folder).files}
    for file in sorted(run.files.keys() | recorded.keys()):
        digest = digest_of(folder / file)
        where = [whose for whose, files in (("manifest", run.files), ("record", recorded)) if files.get(file, digest) != digest]
        if where:
            said.append(
                f"{file}: expected the hash in the {' and the '.join(where)}, found {'another one' if digest else 'no file'}"
            )
    return said


def check_reader(folder: Path) -> None:
    """Raise InputError for a run whose scene is read by code that is not installed here: a pack is to start none."""
    reader = RunSetup.read(folder).config.get("reader", {})
    target = str(reader.get("target", NATIVE_READER))
    if named("reader", str(reader.get("name")), target).distribution == THE_COMMAND_LINE:
        raise InputError(f"{folder / CONFIG}: reader: expected one that is installed here, found {shown(target)}")


def packs_among(paths: Sequence[Path]) -> list[Path]:
    """The zip files among ``paths`` and below those that are folders. Raises InputError for a path where none is."""
    found: list[Path] = []
    for path in paths:
        below = [path] if path.is_file() else sorted(path.rglob("*.zip")) if path.is_dir() else []
        below = [one for one in below if one == path or not (one.parent / METRICS_FILE).is_file()]  # a run's pictures.zip is none
        if not below:
            raise InputError(f"{shown(path)}: expected a pack, or a folder with packs, found none")
        found += below
    return list(dict.fromkeys(found))


def _check_members(path: Path, members: Sequence[zipfile.ZipInfo]) -> None:
    names = [info.filename for info in members]
    if len(names) > MOST_MEMBERS:
        raise InputError(f"{path}: expected at most {MOST_MEMBERS} files in a pack, found {len(names)}")
    for info in members:
        name, kind = info.filename, stat.S_IFMT(info.external_attr >> 16)
        parts = PurePosixPath(name).parts
        if name.startswith("/") or not parts or ".." in parts or "\\" in name or ":" in name or not name.isprintable():
            raise InputError(f"{path}: expected names of files below the pack's folder, found {shown(repr(name))}")
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise InputError(f"{path}: {shown(name)}: expected a file, found a link or a device")
        if info.file_size > MEMBER_BYTES:
            raise InputError(f"{path}: {shown(name)}: expected at most {MEMBER_BYTES >> 20} MB, found {info.file_size >> 20} MB")
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise InputError(f"{path}: expected every file once, found {shown(twice)} twice")
    total = sum(info.file_size for info in members)
    if total > ALL_BYTES:
        raise InputError(f"{path}: expected at most {ALL_BYTES >> 30} GB in a pack, found {total / (1 << 30):.1f} GB")


def _extract(archive: zipfile.ZipFile, name: str, out: Path) -> None:
    """Copy one member; zipfile gives no more bytes than the size that was checked, and raises BadZipFile for others."""
    target = out / name
    target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(name) as member, target.open("wb") as file:
        shutil.copyfileobj(member, file)


def _brought(folder: Path) -> dict[str, Path]:
    """The pictures that a run of method=images has scored, by their names in its folder of a pack; nothing of other methods."""
    method = RunSetup.read(folder).config.get("method", {})
    if method.get("name") != "images":
        return {}
    options = method.get("options", {})
    root, order = user_path("method.options.path", str(options.get("path")), folder=True), options.get("order")
    pictures = [path for path in sorted(root.rglob("*")) if path.suffix in PICTURES and path.is_file()]
    found = {path.relative_to(root).as_posix(): path for path in pictures}
    found |= {} if order in ORDERS else {ORDER: user_path("method.options.order", str(order))}
    return {f"{BROUGHT_PICTURES}/{name}": path for name, path in found.items()}


def _without_home(text: bytes) -> bytes:
    """A JSON text with ~ for the home folder in its paths: it names the user, and ~ is found again on the same machine."""
    home = str(Path.home()).rstrip("/")
    return text.replace(f"{home}/".encode(), b"~/") if home else text


def _instead(path: Path) -> str:
    return "another one" if path.is_file() else "none"
