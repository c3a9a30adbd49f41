"""The command's argument parser: errors in one line, numbers and lists that may begin with a minus sign."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

__all__ = ["Parser", "joined"]

_NUMBER = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")  # argparse's own has no 1e-3
_SIGNED = re.compile(r"-\.?\d")


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._negative_number_matcher = _NUMBER

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: {message} (see {self.prog} --help)", file=sys.stderr)
        sys.exit(2)


def joined(arguments: Sequence[str]) -> list[str]:
    """`arguments` with lists that begin with a minus sign joined to their option: --headings=-15:105:15.

    argparse takes them for options otherwise. A plain number it knows.
    """
    result: list[str] = []
    for argument in arguments:
        option = bool(result) and result[-1].startswith("--") and "=" not in result[-1]
        if option and _SIGNED.match(argument) and not _NUMBER.match(argument):
            result[-1] += f"={argument}"
        else:
            result.append(argument)
    return result
