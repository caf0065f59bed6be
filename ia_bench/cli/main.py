"""``ia-bench COMMAND ...``: every command of the package behind one name; each does its work in a module of its own."""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence
from importlib import import_module

from ia_bench.common.errors import unknown
from ia_bench.common.exit_codes import complain, say

COMMANDS = {
    "run": "reconstruct one scene and score what was recovered",
    "table": "every row x scene x seed of a table, then its report",
    "report": "the tables, curves and page of runs that are there already",
    "score": "scores of what other software recovered: a mesh with textures, or pictures",
    "rescore": "scores of finished runs under another protocol",
    "relight": "pictures of what was recovered under lights of your own",
    "pack": "finished runs as one file that others can score again",
    "verify": "whether packs and published tables give the scores that they say",
    "board": "the report over packs of several people",
    "check": "whether a plug-in keeps its contract, and whether a capture is read well",
    "decompose": "albedo and specular shading behind a picture, by a prior alone",
    "export": "a scene in the layout that other programs read, or as a network wants photographs",
    "watch": "the page of a table while it is being made",
}
"""Name of a command, whose work is done by ``main`` of the module of that name -> what it is for."""

USAGE = """\
ia-bench COMMAND ...

{commands}

ia-bench COMMAND --help says what a command takes; ia-bench --version says which code this is.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Do the command that the first argument names, with the others, and return its exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if platform.system() != "Linux":
        return complain(f"expected Linux, found {platform.system()}; docs/usage.md says what ia_bench runs on")
    if not given or given[0] in ("-h", "--help"):
        width = max(map(len, COMMANDS))
        say(USAGE.format(commands="\n".join(f"  {name:<{width}}  {line}" for name, line in COMMANDS.items())), sys.stdout)
        return 0
    name, *rest = given
    if name == "--version":
        name, rest = "run", ["--version"]
    if name not in COMMANDS:
        return complain(unknown("command", name, COMMANDS))
    if "" not in sys.path:
        sys.path.append("")  # the folder where one is: module:Class is looked for there last, by `python -m ia_bench` first
    status: int = import_module(f"ia_bench.cli.{name}").main(rest)
    return status
