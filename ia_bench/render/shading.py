"""The estimator's two functions, compiled where that works and as they are where it does not."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Any

import torch

from ia_bench.render.estimator import sample_directions, shade_directions


class Shading:
    """:func:`sample_directions` and :func:`shade_directions`, of one ``kind``, "compiled" or "eager".

    A compiler that fails, when it is set up or when it meets the first arguments, is told to ``notice`` once; from then on both
    functions run eagerly.
    """

    def __init__(self, kind: str, notice: Callable[[str], None]) -> None:
        self.kind, self._notice = kind, notice
        self._sample: Callable[..., Any] = sample_directions
        self._shade: Callable[..., Any] = shade_directions
        if kind == "compiled":
            try:
                self._sample = torch.compile(sample_directions, dynamic=False)
                self._shade = torch.compile(shade_directions, dynamic=False)
            except RuntimeError as error:  # a Python or a platform that torch cannot compile for
                self._fall_back(error)

    def sample(self, *arguments: Any) -> Any:  # noqa: ANN401 (as sample_directions)
        """See :func:`ia_bench.render.estimator.sample_directions`."""
        return self._run("_sample", *arguments)

    def shade(self, *arguments: Any) -> Any:  # noqa: ANN401 (as shade_directions)
        """See :func:`ia_bench.render.estimator.shade_directions`."""
        return self._run("_shade", *arguments)

    def _run(self, name: str, *arguments: Any) -> Any:  # noqa: ANN401 (two functions of different signatures)
        if self.kind != "compiled":
            return getattr(self, name)(*arguments)
        try:
            return getattr(self, name)(*arguments)
        except compiler_errors() as error:
            self._fall_back(error)
            return getattr(self, name)(*arguments)

    def _fall_back(self, error: Exception) -> None:
        self.kind = "eager"
        self._sample, self._shade = sample_directions, shade_directions
        reason = (str(error).strip() or "no message").splitlines()[0]
        self._notice(f"shading runs eagerly: torch.compile failed ({type(error).__name__}: {reason})")


def compiler_errors() -> tuple[type[Exception], ...]:
    """What torch.compile raises when it, or the C++ compiler it calls, fails; errors of the compiled code are not among it."""
    from torch._dynamo.exc import InternalTorchDynamoError, ShortenTraceback, Unsupported
    from torch._inductor.exc import CppCompileError, InvalidCxxCompiler

    return InternalTorchDynamoError, ShortenTraceback, Unsupported, CppCompileError, InvalidCxxCompiler


def choose_shading(wanted: str, notice: Callable[[str], None]) -> str:
    """Resolve ``render.shading``: "auto" compiles where a C++ compiler is found, else says so in one line."""
    if wanted != "auto":
        return wanted
    if shutil.which("g++") or shutil.which("clang++") or torch.cuda.is_available():
        return "compiled"
    notice("shading runs eagerly: no C++ compiler found for torch.compile")
    return "eager"
