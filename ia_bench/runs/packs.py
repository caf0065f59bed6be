"""A pack: finished runs as one zip file that others can score again and show beside theirs.

``manifest.json`` says who brings it and what is in it; each run lies in a folder of its own, with its record, its configuration and
every file that it wrote. What is read of a pack is somebody else's: sizes beyond reason are refused, and it starts no code.
"""

from __future__ import annotations

import errno
import hashlib
import re
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from ia_bench.common.atomic_file import whole_file
from ia_bench.common.errors import Fault, InputError
from ia_bench.common.files import files_below, read_json, shown, user_path
from ia_bench.common.ranges import Name
from ia_bench.common.registry import THE_COMMAND_LINE, named
from ia_bench.common.settings import parsed, parsed_file
from ia_bench.methods.images import ORDERS, SUFFIXES
from ia_bench.runs.config import cell_name, config_of
from ia_bench.runs.record import CONFIG, METRICS_FILE, RunRecord, RunSetup, damaged_file, digest_of, json_bytes

MANIFEST = "manifest.json"
FORMAT: Literal[1] = 1
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file within: the same runs give the same bytes
BROUGHT_PICTURES, ORDER = "brought", "order.json"
"""The folder below a run's with the pictures that method=images scored, and the file in it that says their order."""
MOST_MEMBERS, ALL_BYTES = 20_000, 8 << 30  # of files in a pack: how many, and of all, unpacked
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError)
"""What zipfile raises for a file that is none, is cut off, encrypted, or packed in a way that it does not know."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""What the disk says that is written to, and the pack is not to blame for."""


def _within(name: str) -> str:
    """A name that leads to nothing outside of the folder that a pack is unpacked into."""
    if not name or name.startswith("/") or "\\" in name or ".." in name.split("/"):
        raise PydanticCustomError("place", "a path in the pack")
    return name


Within = Annotated[str, AfterValidator(_within)]


@dataclass(frozen=True, kw_only=True)
class PackedRun:
    """One run of a pack; its labels are in its record.

    Attributes:
        folder: Where in the pack its files lie.
        files: Name of a file in the folder -> its SHA-256.
    """

    __pydantic_config__ = ConfigDict(extra="ignore")  # packs of before repeat labels here

    folder: Within
    files: dict[Within, str]


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
    known: set[str] = set()
    homes = sorted({str(Path.home()), str(Path.home().resolve())} - {"/"}, key=len, reverse=True)
    with whole_file(out) as partial, zipfile.ZipFile(partial, "w") as archive:

        def add(name: str, data: bytes) -> str:
            archive.writestr(zipfile.ZipInfo(name, EPOCH), data, zipfile.ZIP_DEFLATED)
            return hashlib.sha256(data).hexdigest()

        for folder in folders:
            record = RunRecord.read(folder)
            damaged = damaged_file(folder, record)
            if damaged is not None:
                found = "another one" if (folder / damaged).is_file() else "none"
                raise InputError(f"{folder / damaged}: expected the file that the run wrote, found {found}")
            if record.name in known:
                raise InputError(f"{folder}: expected one run of {record.name}, found a second one")
            known.add(record.name)
            name = f"runs/{cell_name(record.scene, record.row, record.seed, record.config_hash)}"
            parts = {file: folder / file for file in record.files} | ({} if record.status == "failed" else _brought(folder))
            digests = {file: add(f"{name}/{file}", part.read_bytes()) for file, part in parts.items()}
            for file in (METRICS_FILE, CONFIG):
                text = (folder / file).read_bytes()
                for home in homes:  # it names the user; ~ is found again on the same machine
                    text = re.sub(rb"(?<![\w.~/-])" + re.escape(f"{home}/".encode()), b"~/", text)
                digests[file] = add(f"{name}/{file}", text)
            runs.append(PackedRun(folder=name, files=digests))
        manifest = parsed(Manifest, asdict(Manifest(authors=authors, url=url, note=note, runs=runs)))
        add(MANIFEST, json_bytes(MANIFEST, asdict(manifest)))
    return manifest


def unpack(path: Path, out: Path) -> Manifest:
    """Unpack what the manifest of the pack ``path`` lists into the folder ``out``, and return the manifest.

    Hashes are not asked about (:func:`problems`); nothing is written outside of ``out`` (:meth:`zipfile.ZipFile.extract`). Raises
    InputError for a file that is no pack, is damaged, too large, lacks a file, or has one that its manifest does not list.
    Raises Fault where ``out`` has no room for it.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = [info for info in archive.infolist() if not info.is_dir()]
            names, total = {info.filename for info in members}, sum(info.file_size for info in members)
            if len(members) > MOST_MEMBERS or total > ALL_BYTES:
                most = f"{MOST_MEMBERS} files and {ALL_BYTES >> 20} MB"
                raise InputError(f"{path}: expected at most {most} in a pack, found {len(members)} and {total >> 20}")
            if MANIFEST not in names:
                raise InputError(f"{path}: expected a {MANIFEST} in the pack, found none")
            archive.extract(MANIFEST, out)
            manifest = parsed_file(Manifest, path, read_json(out / MANIFEST), f"{MANIFEST}: ")
            listed = {f"{run.folder}/{file}" for run in manifest.runs for file in run.files}
            if odd := listed - names:
                raise InputError(f"{path}: {MANIFEST} lists {shown(min(odd))}, which is not there")
            if odd := names - {MANIFEST, *listed}:
                raise InputError(f"{path}: {MANIFEST} does not list {shown(min(odd))}, which is in the pack")
            for name in listed:
                archive.extract(name, out)
            return manifest
    except BROKEN as error:
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            raise Fault(f"{shown(path)}: cannot be unpacked into {out} ({error.strerror})") from None
        raise InputError(f"{shown(path)}: expected a pack, found no readable zip file ({shown(error)})") from None


def problems(run: PackedRun, out: Path) -> list[str]:
    """What of an unpacked run is not as its manifest or its own record says; nothing where all agree."""
    said, folder = list[str](), out / run.folder
    try:
        recorded = RunRecord.read(folder).files
        RunSetup.read(folder)
    except InputError as error:
        return [str(error).replace(f"{folder}/", "").replace(str(folder), run.folder)]
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
    reader = config_of(folder).reader
    if named("reader", reader.name, reader.target).distribution == THE_COMMAND_LINE:
        raise InputError(f"{folder / CONFIG}: reader: expected one that is installed here, found {shown(reader.target)}")


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


def _brought(folder: Path) -> dict[str, Path]:
    """The pictures that a run of method=images has scored, by their names in its folder of a pack; nothing of other methods."""
    method = config_of(folder).method
    if method.name != "images":
        return {}
    options = method.options
    root, order = user_path("method.options.path", str(options.get("path")), folder=True), options.get("order")
    pictures = [path for path in files_below(root) if path.suffix in SUFFIXES]
    found = {path.relative_to(root).as_posix(): path for path in pictures}
    found |= {} if order in ORDERS else {ORDER: user_path("method.options.order", str(order))}
    return {f"{BROUGHT_PICTURES}/{name}": path for name, path in found.items()}
