"""The error that pickenv raises for bad input, with a message that says what is wrong and what to do."""


class InputError(ValueError):
    """Raised for bad input from a user, such as a damaged file, an unknown unit or an impossible option.

    The message is one sentence that names the thing at fault and says what to do. The command line prints it unchanged.
    """
