"""Types of settings with their ranges: annotations that :func:`ia_bench.common.settings.parsed` checks."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

UnitInterval = Annotated[float, Field(ge=0, le=1)]
Roughness = Annotated[float, Field(ge=0.03, le=1)]  # perceptual; narrower lobes are beyond float32 (material.brdf.MIN_ROUGHNESS)
NotNegative = Annotated[float, Field(ge=0)]
Weight = Annotated[float, Field(ge=0, le=1e6)]
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]  # of what divides
Rate = Annotated[float, Field(ge=0, le=10)]  # of Adam: how far a step goes, and nothing that is fitted goes farther than 10
Count = Annotated[int, Field(ge=0, le=2**31)]
Number = Annotated[int, Field(ge=1, le=2**31)]
NO_NUMBER = {"decides a number": False}  # metadata of a field that is no part of what identifies a run
NumberOrAuto = Number | Literal["auto"]

LONGEST_NAME = 200  # bytes in UTF-8; folders are called after names, and 255 are the most that file systems take


def _name(text: str) -> str:
    if not text.strip() or not text.isprintable() or len(text.encode()) > LONGEST_NAME:
        raise PydanticCustomError("name", "a name of 1 to {most} printable characters", {"most": LONGEST_NAME})
    return text


Name = Annotated[str, AfterValidator(_name)]  # of a row or a scene: it stands in folders' names and in lines of tables
NameIfAny = Annotated[str, AfterValidator(lambda text: text and _name(text))]  # empty: whoever knows a better one gives it
