"""pkm_cnc program star|circle: test contours as part programs."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from pkm_cnc.cli.arguments import add_machine, setup_of, write_text
from pkm_cnc.contour import circle_program, parse_headings, star_program

__all__ = ["add_parser"]


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("program", help="write a test contour as a part program (mm)")
    contours = parser.add_subparsers(title="contours", metavar="CONTOUR", required=True)

    star = contours.add_parser("star", help="star test: straight lines of many headings through one pivot")
    _add_common(star, 6000.0, _star)
    star.add_argument(
        "--headings",
        default="-15:105:15",
        metavar="LIST",
        help="headings in deg counter-clockwise from +x: first:last:step or a comma list (%(default)s)",
    )
    star.add_argument("--pivot", nargs=2, type=float, default=[0.0, 0.0], metavar=("X", "Y"), help="mm (0 0)")
    star.add_argument("--length", type=float, default=200.0, metavar="MM", help="of each line, mm (%(default)g)")

    circle = contours.add_parser(
        "circle", help="circular test: feed-in, overshoot arc, 360 deg data arc, overshoot, feed-out"
    )
    _add_common(circle, 3000.0, _circle)
    circle.add_argument("--radius", type=float, default=100.0, metavar="MM", help="mm (%(default)g)")
    circle.add_argument("--center", nargs=2, type=float, default=[0.0, 0.0], metavar=("X", "Y"), help="mm (0 0)")
    circle.add_argument("--direction", choices=("ccw", "cw", "both"), default="both", help="(%(default)s)")
    circle.add_argument("--overshoot", type=float, default=180.0, metavar="DEG", help="deg (%(default)g)")


def _add_common(parser: argparse.ArgumentParser, feed: float, action: Any) -> None:
    add_machine(parser)
    parser.add_argument("--feed", type=float, default=feed, metavar="F", help="mm/min (%(default)g)")
    parser.add_argument("-o", "--output", metavar="FILE", help="write to FILE instead of standard output")
    parser.set_defaults(action=action)


def _star(arguments: argparse.Namespace) -> None:
    setup_of(arguments)
    headings = parse_headings(arguments.headings)
    _put(arguments, star_program(arguments.feed, headings, arguments.pivot, arguments.length))


def _circle(arguments: argparse.Namespace) -> None:
    setup = setup_of(arguments)
    text = circle_program(
        feed_mm_min=arguments.feed,
        radius_mm=arguments.radius,
        center_mm=arguments.center,
        direction=arguments.direction,
        overshoot_deg=arguments.overshoot,
        acceleration_mm_s2=setup.motion.acceleration * 1e3,
    )
    _put(arguments, text)


def _put(arguments: argparse.Namespace, text: str) -> None:
    if arguments.output:
        write_text(arguments.output, text)
    else:
        sys.stdout.write(text)
