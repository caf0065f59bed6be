"""The cache gives back what was put, forgets what was used longest ago, and never stops anybody whatever lies in its place."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from ia_bench.common import cache as module
from ia_bench.common.cache import Cache, cache_folder, content_key, made_on

TENSORS = {"sample": torch.rand(2, 5, 7, 3), "bits": torch.arange(6, dtype=torch.uint8), "half": torch.ones(3).half()}
ABOUT = {"seconds": 0.1 + 0.2, "cost": {"network_calls": 40}}
KEY = content_key("things", "a", torch.zeros(3))


@pytest.fixture(autouse=True)
def nothing_said() -> None:
    module.tell_once.cache_clear()


def same(tensors: dict[str, torch.Tensor]) -> bool:
    return set(tensors) == set(TENSORS) and all(torch.equal(tensors[name], TENSORS[name]) for name in tensors)


def test_gives_back_what_was_put_and_makes_only_what_is_not_kept(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "new" / "folder")
    assert cache.get(KEY) is None
    cache.put(KEY, TENSORS, ABOUT)
    found = cache.get(KEY)
    assert same(found[0])
    assert found[1] == ABOUT
    assert [path.name for path in (tmp_path / "new" / "folder").iterdir()] == [f"{KEY}.safetensors"]
    made = []
    for _ in range(2):
        assert same(Cache(tmp_path).kept(KEY, lambda: made.append(1) or TENSORS))  # type: ignore[func-returns-value]
    assert len(made) == 1


def test_keys_are_delimited() -> None:
    assert content_key("x", "ab", "c") != content_key("x", "a", "bc")
    assert content_key("x", torch.zeros(2, 3)) != content_key("x", torch.zeros(3, 2))
    assert content_key("x", torch.zeros(2)) != content_key("x", torch.zeros(2).int())
    assert content_key("x", np.zeros(2, np.float32)) == content_key("x", torch.zeros(2))
    assert content_key("x", "a").startswith("x-")
    assert made_on("cpu", "bake") == "bake" != made_on("cuda", "bake")  # as keys were before there were others


def test_forgets_what_was_used_longest_ago(tmp_path: Path) -> None:
    tensors = {"albedo": torch.zeros(100)}  # 400 bytes and a header
    cache = Cache(tmp_path, limit=1500)
    keys = [content_key("x", str(number)) for number in range(3)]
    for age, key in enumerate(keys[:2]):
        cache.put(key, tensors)
        os.utime(tmp_path / f"{key}.safetensors", (1000 + age, 1000 + age))
    assert cache.get(keys[0]) is not None  # used just now, so the other one is the older
    cache.put(keys[2], tensors)
    assert [cache.get(key) is not None for key in keys] == [True, False, True]


# ---- what may lie in the place of an entry -----------------------------------------------------------------------------
def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


def other_key(path: Path) -> None:
    Cache(path.parent).put(content_key("things", "other"), TENSORS, ABOUT)
    os.replace(path.parent / f"{content_key('things', 'other')}.safetensors", path)


ENTRIES: dict[str, Callable[[Path], object]] = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:100]),
    "a flipped bit": flip,
    "another entry under this name": other_key,
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("name", ENTRIES)
def test_entries_that_are_not_as_written_are_made_again(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    cache = Cache(tmp_path)
    cache.put(KEY, TENSORS, ABOUT)
    ENTRIES[name](tmp_path / f"{KEY}.safetensors")
    for _ in range(2):
        assert same(cache.kept(KEY, lambda: TENSORS))
    said = capsys.readouterr().err.splitlines()
    assert len(said) == len(set(said)) <= 2
    assert f"{KEY}.safetensors: cannot be read" in said[0]


# ---- what may lie in the place of the folder ---------------------------------------------------------------------------
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_folder_that_is_full_or_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: int
) -> None:
    """Root may write anywhere, so the system's answer is put in its mouth."""

    def refuse(tensors: object, path: Path, **_: object) -> None:
        Path(path).write_bytes(b"half of it")
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(module, "save_file", refuse)
    for _ in range(3):
        assert same(Cache(tmp_path).kept(KEY, lambda: TENSORS))
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert os.strerror(number) in said[0]
    assert list(tmp_path.iterdir()) == []


def test_where_it_lies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("IA_BENCH_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert cache_folder() == tmp_path / "caches" / "ia_bench"
    monkeypatch.setenv("IA_BENCH_CACHE", "elsewhere")
    assert cache_folder() == Path("elsewhere")
