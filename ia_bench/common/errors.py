"""The exceptions that the command line shows as a plain message instead of a traceback."""


class InputError(ValueError):
    """Something the user gave is wrong: the message names the file or key, what was expected and what was found."""


class Fault(RuntimeError):
    """What was asked for is right and yet cannot be done: a full disk, a plugin that raises. The message is one sentence."""
