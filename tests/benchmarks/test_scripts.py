"""Every script of benchmarks/ finds what it imports: it is run by hand, and seldom."""

import pkgutil
from importlib import import_module

import pytest

import benchmarks

OPTIONAL = {"mitsuba"}


@pytest.mark.parametrize("name", [one.name for one in pkgutil.walk_packages(benchmarks.__path__, "benchmarks.")])
def test_a_script_can_be_imported(name: str) -> None:
    if name.endswith("__main__"):
        return
    try:
        import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in OPTIONAL:
            raise
        pytest.skip(f"needs {error.name}")
