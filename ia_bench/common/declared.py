"""What is said of results, or of predictions, that were made elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from ia_bench.common.settings import STRICT


@dataclass(frozen=True)
class Declared:
    """What whoever brings results says of them; tables mark it as declared.

    Attributes:
        authors: Who made them.
        code: What made them: a name, an address, a commit.
        hardware: On what machine.
        seconds: How long that took, without scoring; None where nobody says.
    """

    __pydantic_config__ = STRICT

    authors: str = ""
    code: str = ""
    hardware: str = ""
    seconds: Annotated[float, Field(ge=0)] | None = None
