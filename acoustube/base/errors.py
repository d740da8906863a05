"""The two ways in which acoustube refuses: wrong settings, and a solver that gave up."""


class ConfigError(ValueError):
    """A setting, a file or a folder that cannot be used.

    The message is one sentence that names the argument, its value, what is allowed and what to do
    next. The command line prints it and ends with exit code 2.
    """


class SimulationError(RuntimeError):
    """A stage that could not finish, although its settings are valid.

    The message is one sentence that says which stage stopped, why, and what to change. The command
    line prints it and ends with exit code 1.
    """
