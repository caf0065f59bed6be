"""Files that a user gives, opened safely: JSON, YAML and paths, each mistake in one sentence that names it; and their hashes."""

from __future__ import annotations

import difflib
import hashlib
import io
import json
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, NoReturn

import yaml

from ia_bench.common.errors import InputError, printable

DIGITS = 300  # of a whole number, which then is also a float


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object: UTF-8 text with finite numbers, as the standard has it. Raises InputError, naming the file."""
    return _table_in(path, "JSON", partial(json.loads, parse_constant=_refuse_constant, parse_int=_whole))


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML table; an empty file is an empty table. Raises InputError, naming the file."""
    return _table_in(path, "YAML", _by_omegaconf)


def user_path(key: str, text: str, *, folder: bool = False) -> Path:
    """The file, or the ``folder``, that a user names in the setting ``key``, its links followed. Raises InputError if absent."""
    what = "folder" if folder else "file"
    try:
        text.encode()  # what is no UTF-8 could be opened, but neither hashed nor recorded
        path = Path(text).expanduser().resolve(strict=True)
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: a loop of links, or no home folder
        raise InputError(f"{key}={shown(text)}: no such {what}{_unless_absent(error) or _nearest(text)}") from None
    if not text or not (path.is_dir() if folder else path.is_file()):
        found = "nothing" if not text else "a file" if path.is_file() else "none"
        raise InputError(f"{key}={shown(text)}: expected a {what}, found {found}")
    return path


def file_below(folder: Path, value: object, where: str) -> Path:
    """The file below ``folder`` that ``value``, read from a file of the user's, names; ``where`` says which file and key.

    Raises InputError for what is no path or no file, and for a file outside: what a scene is made of lies in its folder.
    """
    if not isinstance(value, str) or not value:
        raise InputError(f"{where}: expected the path of a file, found {shown(repr(value))}")
    problem = ""
    try:
        path, home = (folder / value).resolve(), folder.resolve()
        if not path.is_relative_to(home):
            problem = f"expected a file below {home}, found a path that leads outside"
        elif not path.is_file():
            problem = "expected a file, found a folder" if path.is_dir() else "no such file"
    except (OSError, ValueError, RuntimeError) as error:
        problem = f"no such file{_unless_absent(error)}"
    if problem:
        raise InputError(f"{where}: {shown(value)}: {problem}")
    return folder / value


def paths_in(options: Mapping[str, Any]) -> list[Path]:
    """The files and folders that options name."""
    found: list[Path | None] = []
    mapped(options, lambda text: found.append(path_in(text)) or text)  # type: ignore[func-returns-value]
    return [path for path in found if path is not None]


def path_in(text: str, paths: Collection[Path] = ()) -> Path | None:
    """The file or folder that a setting names, or one of ``paths``, be it by a word.

    A word alone, which may be called like a file by chance, names no other.
    """
    try:
        path = Path(text).expanduser().resolve()
        known = bool(text) and path.exists() and (path in paths or path.is_file() and (os.sep in text or "." in text))
        return path if known or os.sep in text and path.is_dir() else None
    except (OSError, ValueError, RuntimeError):  # no name of a file
        return None


def mapped(value: Any, change: Callable[[str], str]) -> Any:  # noqa: ANN401 (JSON)
    """JSON with ``change`` applied to every text or path that is a value; keys stay as they are."""
    if isinstance(value, Mapping):
        return {key: mapped(part, change) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [mapped(part, change) for part in value]
    return change(str(value)) if isinstance(value, str | Path) else value


def is_file(path: Path) -> bool:
    """Whether ``path`` is a file; no path is too long, too deep or too strange to be asked about."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def files_below(place: Path) -> list[Path]:
    """The file ``place``, or all files below that folder, sorted; linked folders are entered, too, but none from within itself."""
    found, above = [place] if place.is_file() else [], {str(place): {os.path.realpath(place)}}
    for folder, parts, names in os.walk(place, followlinks=True):
        real = {part: os.path.realpath(os.path.join(folder, part)) for part in parts}
        parts[:] = [part for part in parts if real[part] not in above[folder]]
        above |= {os.path.join(folder, part): above[folder] | {real[part]} for part in parts}
        found += [path for name in names if (path := Path(folder, name)).is_file()]
    return sorted(found)


def hash_of_files(root: Path, files: Iterable[Path]) -> str:
    """SHA-256 (hex) over the names below ``root`` (of a file elsewhere its own name) and the bytes of ``files``, in their order.

    Kept for as long as no size and no time of change differs: a table asks once for every cell. Raises OSError for a file that
    cannot be read.
    """
    states = ((file, file.stat()) for file in files)
    return _hash_of_states(root, tuple((file, state.st_size, state.st_mtime_ns) for file, state in states))


@cache
def _hash_of_states(root: Path, files: tuple[tuple[Path, int, int], ...]) -> str:
    digest = hashlib.sha256()
    for path, size, _ in files:
        name = path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name
        digest.update(f"{name}\0{size}\n".encode())
        with path.open("rb") as opened:
            while block := opened.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def compact_json(content: object) -> str:
    """JSON without a blank that nobody reads."""
    return json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def shown(name: object) -> str:
    """A path or value as one short line that every terminal can print."""
    text = printable(str(name))
    return text if len(text) <= 300 else f"{text[:120]}...{text[-120:]} ({len(text)} characters)"


def _table_in(path: Path, what: str, parse: Callable[[str], object]) -> dict[str, Any]:
    try:
        if path.exists() and not path.is_file():  # a pipe or a device may never end
            raise InputError(f"{shown(path)}: expected a file, found {'a folder' if path.is_dir() else 'a pipe or a device'}")
        text = path.read_bytes().decode("utf-8-sig")  # a byte order mark, as editors of Windows write it, says nothing
    except UnicodeDecodeError as error:
        raise InputError(f"{shown(path)}: expected {what} as UTF-8 text, found other bytes at {error.start}") from None
    except OSError as error:
        raise InputError(f"{shown(path)}: no such file{_unless_absent(error)}") from None
    try:
        content = parse(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{shown(path)}: not valid {what} ({_reason(error)})") from None
    if not isinstance(content, dict):
        kind = "JSON object" if what == "JSON" else "YAML table"
        raise InputError(f"{shown(path)}: expected a {kind}, found {type(content).__name__}")
    return content


def _by_omegaconf(text: str) -> object:
    """What Hydra would read: 5e-1 is a number, a date is a text, and a key that stands twice is a mistake."""
    from omegaconf import OmegaConf  # not with this module, most of whose readers want JSON
    from omegaconf.errors import OmegaConfBaseException

    try:
        return OmegaConf.to_container(OmegaConf.load(io.StringIO(text)))
    except (OmegaConfBaseException, OSError) as error:  # OSError: of what is neither a table nor a list
        raise ValueError(str(error).partition("\n")[0]) from error


def _whole(digits: str) -> int:
    if len(digits) > DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")


def _reason(error: Exception) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else shown(" ".join(str(error).split()))


def _nearest(text: str) -> str:
    """What a path that leads nowhere may have meant, of what lies beside it; nothing where nothing is called alike."""
    path = Path(text).expanduser()
    with suppress(OSError):
        near = difflib.get_close_matches(path.name, [one.name for one in path.parent.iterdir()], n=1)
        return f"; did you mean {shown(str(path.parent / near[0]))}?" if near else ""
    return ""


def _unless_absent(error: Exception) -> str:
    """Why a path leads nowhere, in brackets, unless it is just not there."""
    if isinstance(error, FileNotFoundError):
        return ""
    return f" ({error.strerror if isinstance(error, OSError) and error.strerror else _reason(error)})"
