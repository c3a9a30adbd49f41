"""The command called in this process: as fast as a function, with what it would print and its exit status."""

from __future__ import annotations

import contextlib
import io
import sys
from typing import NamedTuple
from unittest import mock

from pkm_cnc.cli import main


class Result(NamedTuple):
    """Exit status, standard output, standard error."""

    code: int
    out: str
    err: str


def pkm(*arguments: object, stdin: str = "") -> Result:
    """Run `pkm_cnc ARGUMENTS`. What the command lets through is an error of the test: a user would see a traceback."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.object(sys, "stdin", io.StringIO(stdin)),
    ):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:  # --help and argparse
            code = int(end.code or 0)
    return Result(code, out.getvalue(), err.getvalue())


def done(*arguments: object, stdin: str = "") -> str:
    """The standard output of a command that must end well and silently."""
    result = pkm(*arguments, stdin=stdin)
    assert (result.code, result.err) == (0, "")
    return result.out


def refused(*arguments: object, stdin: str = "", code: int = 2) -> str:
    """The one line on stderr of a command that must fail with `code` and print nothing."""
    result = pkm(*arguments, stdin=stdin)
    lines = result.err.splitlines()
    assert (result.code, result.out, len(lines)) == (code, "", 1), result
    assert lines[0].startswith("pkm_cnc")
    return lines[0]
