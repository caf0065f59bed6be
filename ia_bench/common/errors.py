"""The exceptions that the command line shows as a plain message instead of a traceback."""

from pathlib import Path


class InputError(ValueError):
    """Something the user gave is wrong: the message names the file or key, what was expected and what was found."""


class Fault(RuntimeError):
    """What was asked for is right and yet cannot be done: a full disk, a plugin that raises. The message is one sentence."""


def first_line(error: BaseException) -> str:
    """The first line of an error that may have many; its kind where it says nothing."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)


def place_of(error: BaseException) -> str:
    """The file and line that an exception came from, "my_prior.py:28"; empty where it has no traceback."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return "" if place is None else f"{Path(place.tb_frame.f_code.co_filename).name}:{place.tb_lineno}"


def raised(error: BaseException) -> str:
    """The kind of an exception and the first line of what it says."""
    return f"{type(error).__name__}: {first_line(error) if str(error) else 'no message'}"
