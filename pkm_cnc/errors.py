"""What can go wrong, by whose doing: every error a user meets is one of these and is one line of text."""

__all__ = ["InputError", "MachineFault", "PkmError", "UnreachableError"]


class PkmError(Exception):
    """Base of all errors that are reported as one line on stderr, never as a traceback."""

    exit_code = 1


class InputError(PkmError):
    """What the user gave cannot be used: program, parameter, path. The command exits with 2."""

    exit_code = 2


class UnreachableError(InputError):
    """A pose or a set of joint positions that the machine's geometry does not allow."""


class MachineFault(PkmError):
    """Something failed while the machine ran. The command exits with 1."""
