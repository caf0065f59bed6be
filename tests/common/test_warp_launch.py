"""Launches over tensors: every item once whatever the threads, sums that no thread loses, mistakes that are refused."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
import warp as wp

from ia_bench.common.warp_launch import LEAST_ITEMS, launch

CPU = torch.device("cpu")
COUNTS = (0, 1, LEAST_ITEMS - 1, LEAST_ITEMS, LEAST_ITEMS + 1, 3 * LEAST_ITEMS + 7)


@wp.kernel(enable_backward=False)
def _count(first: int, factor: int, values: wp.array(dtype=int)):
    n = first + wp.tid()
    values[n] = values[n] + factor * n


@wp.kernel(enable_backward=False)
def _sums(
    first: int, vectors: wp.array(dtype=wp.vec3), scale: wp.array(dtype=float), has_scale: int,
    total: wp.array(dtype=wp.vec3), other: wp.array(dtype=float),
):  # fmt: skip
    n = first + wp.tid()
    wp.atomic_add(total, n % 2, vectors[n])
    if has_scale > 0:
        wp.atomic_add(other, 0, scale[n])


@wp.kernel(enable_backward=False)
def _of_several_axes(first: int, table: wp.array2d(dtype=wp.vec3), flat: wp.array(dtype=wp.float64), found: wp.array(dtype=float)):
    n = first + wp.tid()
    found[n] = table[n, 1][2] + float(flat[n])


@pytest.fixture(params=[1, 2, 3], ids=lambda n: f"{n} threads")
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.mark.parametrize("count", COUNTS)
def test_every_item_runs_once(count: int, threads: int) -> None:
    values = torch.ones(count, dtype=torch.int32)
    launch(_count, count, 3, values, device=CPU)
    assert torch.equal(values, 1 + 3 * torch.arange(count, dtype=torch.int32))


@pytest.mark.parametrize("count", COUNTS)
def test_no_sum_is_lost_between_threads(count: int, threads: int) -> None:
    """Whole numbers, so that their order does not matter; sums start from what is there already."""
    vectors = torch.randint(9, (count, 3), generator=torch.Generator().manual_seed(0)).float()
    scale = torch.arange(count).float() % 5
    total, other = torch.full((2, 3), 7.0), torch.zeros(1)
    launch(_sums, count, vectors, scale, 1, sums=[total, other], device=CPU)
    wanted = torch.stack([vectors[::2].sum(0), vectors[1::2].sum(0)]) + 7
    assert torch.equal(total, wanted)
    assert float(other) == float(scale.sum())


def test_none_stands_for_an_array_and_for_a_sum_of_nothing(threads: int) -> None:
    count = 4 * LEAST_ITEMS
    total = torch.zeros(2, 3)
    launch(_sums, count, torch.ones(count, 3), None, 0, sums=[total, None], device=CPU)
    assert torch.equal(total, torch.full((2, 3), count / 2))


def test_an_error_in_a_thread_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    import ia_bench.common.warp_launch as module

    ends = []

    def fails(kernel: wp.Kernel, items: int, arguments: list[object], **_: object) -> None:
        ends.append(arguments[0])
        if arguments[0] != 0:
            raise MemoryError("of the second range")

    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    monkeypatch.setattr(module.wp, "launch", fails)
    with pytest.raises(MemoryError, match="of the second range"):
        launch(_count, 4 * LEAST_ITEMS, 3, torch.zeros(4 * LEAST_ITEMS, dtype=torch.int32), device=CPU)
    assert sorted(ends) == [0, 2 * LEAST_ITEMS]


GOOD = {"table": torch.ones(5, 2, 3), "flat": torch.ones(5, dtype=torch.float64), "found": torch.zeros(5)}


def test_vectors_take_the_last_axis() -> None:
    launch(_of_several_axes, 5, *GOOD.values(), device=CPU)
    assert (GOOD["found"] == 2).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("table", torch.ones(5, 3)),  # an axis too few
        ("table", torch.ones(5, 2, 4)),  # no vectors of three
        ("table", torch.ones(5, 2, 3, dtype=torch.float64)),
        ("table", torch.ones(5, 3, 2).transpose(1, 2)),  # a vector is scattered in memory
        ("flat", torch.ones(5)),
        ("found", torch.zeros(5, dtype=torch.int32)),
    ],
    ids=lambda value: value if isinstance(value, str) else f"{tuple(value.shape)} {value.dtype}",
)
def test_other_tensors_than_the_kernels_are_refused(name: str, value: torch.Tensor) -> None:
    with pytest.raises((ValueError, RuntimeError)):
        launch(_of_several_axes, 5, *(GOOD | {name: value}).values(), device=CPU)


@pytest.mark.parametrize("name", GOOD)
def test_a_tensor_on_another_device_is_refused(name: str) -> None:
    """By its name, before an address of one memory is followed in another, which ends a process or all of CUDA in it."""
    with pytest.raises(ValueError, match=rf"\({name}\): expected a tensor on cpu, found one on meta"):
        launch(_of_several_axes, 5, *(GOOD | {name: GOOD[name].to("meta")}).values(), device=CPU)


SCRIPT = "import torch; from ia_bench.material.textures import fetch; fetch(torch.ones(2, 2, 3), torch.ones(4, 2))"


def test_nothing_is_printed() -> None:
    """Not of Warp, its modules, its compiler or a GPU that is not there: output belongs to the commands."""
    ended = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert (ended.stdout, ended.stderr) == ("", "")


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "WARP_CACHE_PATH"])
def test_a_folder_that_keeps_no_kernels_stops_nothing(variable: str, tmp_path: Path) -> None:
    environment = {**os.environ, variable: "/dev/null/kernels", "TMPDIR": str(tmp_path)}
    ended = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, env=environment)
    assert re.fullmatch(
        r"ia_bench: cache: /dev/null/kernels.*: no kernels can be kept there \(.*\); set WARP_CACHE.*\n", ended.stderr
    )
    assert list(tmp_path.iterdir()) == []
