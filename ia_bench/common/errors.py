"""The exceptions that the command line shows as a plain message instead of a traceback."""


class InputError(ValueError):
    """Something the user gave is wrong: the message names the file or key, what was expected and what was found."""


class Fault(RuntimeError):
    """What was asked for is right and yet cannot be done: a full disk, a plugin that raises. The message is one sentence."""


def first_line(error: BaseException) -> str:
    """The first line of an error that may have many; its kind where it says nothing."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)


def raised(error: BaseException) -> str:
    """The kind of an exception and the first line of what it says."""
    return f"{type(error).__name__}: {first_line(error) if str(error) else 'no message'}"
