"""The one error that bad input raises: a clear sentence for a person, naming what is at fault and what to do."""


class InputError(ValueError):
    """Bad input from a user: a file, a row, a unit, a joint, an option.

    The message is one sentence that names the thing at fault and says what to do; the command line prints it as is.
    """
