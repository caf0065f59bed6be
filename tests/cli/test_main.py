"""``ia-bench COMMAND``: each command behind one name, run as a user runs it."""

import subprocess
import sys
from pathlib import Path

import pytest

from ia_bench.cli.main import COMMANDS

COMMAND = str(Path(sys.executable).with_name("ia-bench"))


def ia_bench(*arguments):
    return subprocess.run([COMMAND, *arguments], capture_output=True, text=True)


def test_help_lists_every_command_with_what_it_is_for():
    shown = ia_bench("--help")
    assert shown.returncode == 0
    assert all(f"  {name} " in shown.stdout and line in shown.stdout for name, (_, line) in COMMANDS.items())


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_says_what_it_takes(name):
    shown = ia_bench(name, "--help")
    assert shown.returncode == 0, shown.stderr
    assert name in shown.stdout
    assert len(shown.stdout.splitlines()) <= 40, "more than one screen"


def test_a_misspelt_command_is_one_sentence():
    failed = ia_bench("rapport")
    assert failed.returncode == 2
    assert failed.stderr.startswith("ia_bench: unknown command 'rapport'; did you mean 'report'?")


def test_the_version_is_that_of_the_package():
    assert ia_bench("--version").stdout.split()[0] == "ia_bench"
