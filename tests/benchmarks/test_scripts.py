"""Every script of benchmarks/ finds what it imports: it is run by hand, and seldom."""

import pkgutil
from importlib import import_module

import pytest

import benchmarks

NAMES = [one.name for one in pkgutil.walk_packages(benchmarks.__path__, "benchmarks.") if not one.name.endswith("__main__")]


@pytest.mark.parametrize("name", NAMES)
def test_a_script_can_be_imported(name: str) -> None:
    try:
        import_module(name)
    except ImportError as error:
        if "itsuba" not in str(error):
            raise
        pytest.skip(str(error))
