"""Files that a user gives, opened safely: JSON, YAML and paths, each mistake in one sentence that names it; and their hashes."""

from __future__ import annotations

import hashlib
import json
import math
import stat
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import yaml

from ia_bench.common.errors import InputError, printable

MAX_BYTES = 256 << 20
"""Of a file of text: a larger one was not meant."""
MAX_VALUES = 100_000
"""Values that a YAML file may hold once its aliases are written out; a few lines of aliases to aliases stand for billions."""


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object: UTF-8 text with finite numbers, as the standard has it. Raises InputError, naming the file."""
    text = _read_text(path, "JSON")
    try:
        content = json.loads(text, parse_int=_whole, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{shown(path)}: not valid JSON ({_reason(error)})") from None
    if not isinstance(content, dict):
        raise InputError(f"{shown(path)}: expected a JSON object, found {type(content).__name__}")
    return content


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML table of at most MAX_VALUES values; an empty file is an empty table. Raises InputError, naming the file."""
    text = _read_text(path, "YAML")
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a date that does not exist
        raise InputError(f"{shown(path)}: not valid YAML ({_reason(error)})") from None
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f"{shown(path)}: expected a YAML table, found {type(content).__name__}")
    waiting, count = [content], 0
    while waiting:
        value = waiting.pop()
        count += 1
        if count > MAX_VALUES:
            raise InputError(f"{shown(path)}: expected at most {MAX_VALUES} values, aliases written out, found more")
        waiting.extend(value.values() if isinstance(value, dict) else value if isinstance(value, list) else ())
    return content


def user_path(key: str, text: str, *, folder: bool = False) -> Path:
    """The file, or the ``folder``, that a user names in the setting ``key``, its links followed. Raises InputError if absent."""
    what = "folder" if folder else "file"
    try:
        text.encode()  # what is no UTF-8 could be opened, but neither hashed nor recorded
        path = Path(text).expanduser().resolve(strict=True)
        if not text:
            raise InputError(f"{key}: expected a {what}, found nothing")
        if not (path.is_dir() if folder else path.is_file()):
            raise InputError(f"{key}={shown(text)}: expected a {what}, found {'a file' if folder else 'none'}")
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: a loop of links, or no home folder
        if isinstance(error, InputError):
            raise
        raise InputError(f"{key}={shown(text)}: no such {what}{_unless_absent(error)}") from None
    return path


def file_below(folder: Path, value: object, where: str) -> Path:
    """The file below ``folder`` that ``value``, read from a file of the user's, names; ``where`` says which file and key.

    Raises InputError for what is no path or no file, and for a file outside: what a scene is made of lies in its folder.
    """
    if not isinstance(value, str) or not value:
        raise InputError(f"{where}: expected the path of a file, found {shown(repr(value))}")
    try:
        path, home = (folder / value).resolve(), folder.resolve()
        if not path.is_relative_to(home):
            raise InputError(f"{where}: {shown(value)}: expected a file below {home}, found a path that leads outside")
        if not path.is_file():
            raise InputError(f"{where}: {shown(value)}: {'expected a file, found a folder' if path.is_dir() else 'no such file'}")
    except (OSError, ValueError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: {shown(value)}: no such file{_unless_absent(error)}") from None
    return folder / value


def is_file(path: Path) -> bool:
    """Whether ``path`` is a file; no path is too long, too deep or too strange to be asked about."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def hash_of_files(root: Path, files: Iterable[Path]) -> str:
    """SHA-256 (hex) over the names below ``root`` and the bytes of ``files``, in the order in which they are given.

    A file that lies elsewhere has its own name alone.

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


def shown(name: object) -> str:
    """A path or value as one short line that every terminal can print."""
    text = printable(str(name))
    return text if len(text) <= 300 else f"{text[:120]}...{text[-120:]} ({len(text)} characters)"


def _read_text(path: Path, what: str) -> str:
    try:
        state = path.stat()
        if not (stat.S_ISREG(state.st_mode) or stat.S_ISDIR(state.st_mode)):  # a pipe or a device may never end
            raise InputError(f"{shown(path)}: expected a file, found a pipe, a device or a socket")
        if state.st_size > MAX_BYTES:
            raise InputError(f"{shown(path)}: expected {what} of at most {MAX_BYTES >> 20} MB, found {state.st_size >> 20} MB")
        return path.read_bytes().decode("utf-8-sig")  # a byte order mark, as editors of Windows write it, says nothing
    except UnicodeDecodeError as error:
        raise InputError(f"{shown(path)}: expected {what} as UTF-8 text, found other bytes at {error.start}") from None
    except IsADirectoryError:
        raise InputError(f"{shown(path)}: expected a file, found a folder") from None
    except FileNotFoundError:
        raise InputError(f"{shown(path)}: no such file") from None
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{shown(path)}: no readable file{_unless_absent(error)}") from None


def _whole(text: str) -> int:
    if len(text) > 308 and not math.isfinite(float(text)):
        raise ValueError(f"a whole number of {len(text)} digits, beyond every float")
    return int(text)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")


def _reason(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return "nested too deeply"
    return shown(" ".join(str(error).split()))


def _unless_absent(error: Exception) -> str:
    """Why a path leads nowhere, in brackets, unless it is just not there."""
    if isinstance(error, FileNotFoundError):
        return ""
    return f" ({error.strerror if isinstance(error, OSError) and error.strerror else _reason(error)})"
