"""pkm_cnc kinematics: CSV of poses to CSV of joint positions and back; geometry only."""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Iterator, Sequence
from typing import Any, TextIO

from pkm_cnc.cli.arguments import add_machine, setup_of
from pkm_cnc.errors import InputError, UnreachableError

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("kinematics", help="CSV on stdin to CSV on stdout, 17 significant digits")
    parser.add_argument(
        "direction", choices=("inverse", "forward"), help="TCP (x_mm,...) to joints (u1_mm,...), or back; geometry only"
    )
    add_machine(parser)
    parser.set_defaults(action=_kinematics)


def _kinematics(arguments: argparse.Namespace) -> None:
    machine = setup_of(arguments).kinematics
    poses = [f"{name}_mm" for name in machine.coordinates]
    joints = [f"{name}_mm" for name in machine.axes]
    read, write = (poses, joints) if arguments.direction == "inverse" else (joints, poses)
    transform = machine.inverse if arguments.direction == "inverse" else machine.forward
    rows = _rows(sys.stdin, read)
    next(rows)  # the header is right
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(write)
    for line, values in rows:
        try:
            result = [value * 1e3 for value in transform([value / 1e3 for value in values]).tolist()]
        except UnreachableError as error:
            print(f"pkm_cnc: stdin:{line}: {error}", file=sys.stderr)
            result = [math.nan] * len(write)
        writer.writerow([f"{value:.17g}" for value in result])


def _rows(source: TextIO, columns: Sequence[str]) -> Iterator[tuple[int, list[float]]]:
    """The header (no values) and then the rows, each with its line."""
    reader = csv.reader(source)
    try:
        header = [name.strip() for name in next(reader, [])]
        if header != list(columns):
            raise InputError(f"stdin:1: columns {','.join(header) or '(none)'}, expected {','.join(columns)}")
        yield 1, []
        for row in reader:
            if row:
                yield reader.line_num, _values(row, len(columns))
    except (csv.Error, ValueError) as error:
        raise InputError(f"stdin:{max(reader.line_num, 1)}: {error}") from None


def _values(row: Sequence[str], columns: int) -> list[float]:
    if len(row) != columns:
        raise ValueError(f"{len(row)} values, {columns} expected")
    return [float(cell) for cell in row]
