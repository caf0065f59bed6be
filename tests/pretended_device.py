"""A CUDA device that is the CPU: what computes on it gets its numbers, and what mixes up the two devices raises.

Every storage says where it is. One without a word, of an array or a file, is on the CPU; what torch makes inside of an operation,
as the zeros of a backward pass, may be anywhere.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
import warp as wp
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes
from torch.utils._pytree import tree_iter

from ia_bench.common import machine
from ia_bench.common.native import LANES
from ia_bench.render.rays import WarpRays

CPU, CUDA, ANYWHERE = "cpu", "cuda", "anywhere"
COPIES = "aten._to_copy", "aten.copy"  # between devices, if need be
INDEXES = "aten.index.", "aten.index_put", "aten._index_put"  # whose indices may be on the CPU
JOINS = "aten.cat", "aten.stack"  # which take no single number of the CPU, as most others do
PARTS = {
    torch.sparse_coo: ("_indices", "_values"),
    torch.sparse_csr: ("crow_indices", "col_indices", "values"),
    torch.sparse_csc: ("ccol_indices", "row_indices", "values"),
}


class MixedDevices(RuntimeError):
    """On a real device torch would say as much."""


def _tensors(*values: object) -> list[Tensor]:
    return [each for each in tree_iter(values) if isinstance(each, Tensor)]


def _storages(tensor: Tensor) -> list[Any]:
    names = PARTS.get(tensor.layout, ("detach",))
    with torch._C.DisableTorchFunction(), _disable_current_modes():
        return [getattr(tensor, name)().untyped_storage() for name in names]


def _place(tensor: Tensor) -> str:
    return str(getattr(_storages(tensor)[-1], "place", CPU))


def _put(values: object, place: str, *, fresh: bool = False) -> None:
    """Say where ``values`` are; ``fresh``: those of which nothing has been said."""
    for storage in (one for each in _tensors(values) for one in _storages(each)):
        if not fresh or not hasattr(storage, "place"):
            storage.place = place


class _Checked(TorchDispatchMode):
    """Below autograd: operations take tensors of one device, and make others there."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name, given = str(func), _tensors(args, kwargs)
        places = [_place(each) for each in given]
        if name.startswith(COPIES):
            places = places[:1]
        if CPU in places and CUDA in places:
            indices = _tensors(args[1]) if name.startswith(INDEXES) and places[0] == CUDA else []
            for each, place in zip(given, places, strict=True):
                changed = each is given[0] and name.split(".")[1].endswith("_")
                number = not each.ndim and not changed and not name.startswith(JOINS)
                if place == CPU and not number and all(each is not one for one in indices):
                    raise MixedDevices(f"{name}: expected tensors on {CUDA}, found one of shape {tuple(each.shape)} on {CPU}")
        found = func(*args, **(kwargs or {}))
        _put(found, next((place for place in (CUDA, CPU) if place in places), ANYWHERE), fresh=True)
        return found


class _Answering(TorchFunctionMode):
    """Above autograd: what is asked for on the device is made on the CPU, and said to be there."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        name, given = getattr(func, "__name__", ""), _tensors(args, kwargs)
        if func == Tensor.device.__get__:  # type: ignore[attr-defined]
            return torch.device(CUDA, 0) if _place(args[0]) == CUDA else func(*args)
        if name == "numpy" and _place(args[0]) == CUDA:
            raise MixedDevices(f"numpy(): expected a tensor on {CPU}, found one of shape {tuple(args[0].shape)} on {CUDA}")
        if func in (Tensor.to, Tensor.cpu):
            return _brought(*args, **kwargs) if func == Tensor.to else _brought(args[0], CPU)
        asked = kwargs.pop("device", None)
        device = torch.device(asked).type if asked is not None else _place(given[0]) if given else CPU
        if getattr(kwargs.get("generator"), "place", device) != device:
            raise MixedDevices(f"{name}: expected a generator on {device}, found one on {kwargs['generator'].place}")
        found = func(*args, **kwargs)
        _put(found, device, fresh=asked is None and bool(given) and not name.startswith("new_"))
        return found


def _brought(tensor: Tensor, *how: Any, **kwargs: Any) -> Tensor:
    """What ``tensor.to`` does with these arguments: a copy where the place is another one."""
    like = [part for each in how if isinstance(each, Tensor) for part in (_place(each), each.dtype)]
    asked = [kwargs.pop("device", None), *(like or how)]
    places = [torch.device(each).type for each in asked if isinstance(each, str | torch.device)]
    dtypes = [each for each in (*asked, kwargs.pop("dtype", None)) if isinstance(each, torch.dtype)]
    found = tensor.to(*dtypes, **{key: value for key, value in kwargs.items() if value is not None})
    if places and places[0] != _place(tensor):
        found = found.clone()
        _put(found, places[0])
    return found


class _Generator(torch.Generator):
    place: str

    def __new__(cls, device: Any = CPU) -> "_Generator":
        made = super().__new__(cls, CPU)
        made.place = torch.device(device).type
        return made

    @property
    def device(self) -> torch.device:  # type: ignore[override]
        return torch.device(self.place)


@contextmanager
def pretended_cuda(patch: pytest.MonkeyPatch, cache: Path) -> Iterator[torch.device]:
    """A device ``cuda`` as long as the block lasts; what is baked for it goes into a ``cache`` of its own."""
    launch, from_torch, rays = wp.launch, wp.from_torch, WarpRays.__init__

    def launched(kernel: Any, count: int, values: list[Any], device: str) -> None:
        if torch.device(device).type == CUDA and kernel.key == "draw":  # whose native code takes LANES points here, and 1 there
            count, values = -(-count // LANES), [values[0], LANES, *values[2:]]
        launch(kernel, count, values, device=CPU)

    def taken(*args: Any, **kwargs: Any) -> Any:
        with torch._C.DisableTorchFunction():
            return from_torch(*args, **kwargs)

    patch.setattr(wp, "launch", launched)
    patch.setattr(wp, "from_torch", taken)
    patch.setattr(WarpRays, "__init__", lambda self, mesh, device: rays(self, mesh, torch.device(CPU)))
    patch.setattr(torch, "Generator", _Generator)
    patch.setattr(torch.cuda, "is_available", lambda: True)
    patch.setattr(torch.cuda, "is_bf16_supported", lambda: False)
    patch.setattr(machine, "available_memory", lambda device: 2**33)
    patch.setenv("IA_BENCH_CACHE", str(cache))
    with _Answering(), _Checked():
        yield torch.device(CUDA)
