"""Arguments that several subcommands share, and writing what they make."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from pkm_cnc.config import Setup, load_setup
from pkm_cnc.errors import InputError
from pkm_cnc.program import Program, read_program, with_reference
from pkm_cnc.report import write_whole

__all__ = [
    "add_bag",
    "add_from_line",
    "add_machine",
    "add_program",
    "add_reference",
    "make_folder",
    "print_bag",
    "program_of",
    "setup_of",
    "write_text",
]


def add_machine(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add --machine, which must be given if it has no default, and --set."""
    parser.add_argument(
        "--machine",
        required=default is None,
        default=default,
        metavar="F",
        help="machine file, or the bare name of one in config/" + (f" ({default})" if default else ""),
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a parameter, for all axes (drive.kv=25) or one (u1.drive.kv=25); repeatable",
    )


def add_program(parser: argparse.ArgumentParser) -> None:
    """Add PROGRAM and the machine that it is for."""
    parser.add_argument("program", metavar="PROGRAM", help="part program (RS-274, mm)")
    add_machine(parser)


def add_reference(parser: argparse.ArgumentParser) -> None:
    """Add the program whose contour counts."""
    parser.add_argument(
        "--reference",
        metavar="FILE",
        help="part program whose contour the run is judged by, in the same order (PROGRAM, or what it was made from)",
    )


def program_of(arguments: argparse.Namespace) -> Program:
    """PROGRAM, with --reference, if there is one. Raises InputError."""
    program = read_program(arguments.program)
    return with_reference(program, read_program(arguments.reference)) if arguments.reference else program


def add_bag(parser: argparse.ArgumentParser) -> None:
    """Add the bag to be recorded."""
    parser.add_argument("--bag", required=True, metavar="DIR", help="folder of the bag; must not exist")


def add_from_line(parser: argparse.ArgumentParser) -> None:
    """Add --from-line."""
    parser.add_argument(
        "--from-line",
        type=_line_number,
        default=0,
        metavar="N",
        help="begin at the first motion of line N or after it",
    )


def _line_number(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) < 2**31:
        raise argparse.ArgumentTypeError(f"{text!r} is not the number of a line")
    return int(text)


def print_bag(bag: str, machine: float, wall: float) -> None:
    """Say what was recorded: machine time and wall time in s."""
    print(f"bag {bag}: {machine:.3f} s of machine time in {wall:.1f} s ({machine / wall:.2f} x real time)")


def setup_of(arguments: argparse.Namespace) -> Setup:
    """The machine that --machine and --set name. Raises InputError."""
    return load_setup(arguments.machine, arguments.set)


def make_folder(folder: Path) -> None:
    """Make a folder for what will be known after minutes of work. Raises InputError now if it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(f"report {folder}: {error.strerror}") from None


def write_text(path: str, text: str) -> None:
    """Write a file whole or not at all; into what is no plain file (a device, a pipe, a link) the text is just written.

    Raises InputError where it cannot be written.
    """
    target = Path(path)
    if not target.is_symlink() and (target.is_file() or not target.exists()):
        write_whole(target, text.encode())
        return
    try:
        target.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
