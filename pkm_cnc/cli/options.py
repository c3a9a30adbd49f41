"""Options as arguments of the command: one flag per parameter of their dataclass."""

from __future__ import annotations

import argparse
from typing import Any

from pkm_cnc.contour import parse_numbers
from pkm_cnc.errors import InputError
from pkm_cnc.parameters import Parameter, Value, parameters_of

__all__ = ["add_options", "options_of"]


def add_options(parser: argparse.ArgumentParser, options: type[Any], title: str = "options of this experiment") -> None:
    """Add a flag for every parameter that `options` declares, in a group of that title."""
    group = parser.add_argument_group(title)
    for spec in parameters_of(options):
        _add(group, spec)


def options_of(arguments: argparse.Namespace, options: type[Any]) -> Any:
    """An instance of `options` from the parsed flags. Raises InputError naming flag, value and bound."""
    given: dict[str, Value] = {}
    for spec in parameters_of(options):
        value = getattr(arguments, _place(spec))
        if value is not None:
            given[spec.name] = spec.check(_typed(spec, value), _flag(spec))
    return options(**given)


def _add(group: Any, spec: Parameter) -> None:
    unit = f" {spec.unit}" if spec.unit else ""
    words: dict[str, Any] = {
        "dest": _place(spec),
        "default": None,
        "help": f"{spec.doc}{' (' + _text(spec) + unit + ')'}".replace("%", "%%"),
    }
    if isinstance(spec.default, bool):
        words["action"] = argparse.BooleanOptionalAction
    elif spec.each > 1:
        words |= {"action": "append", "nargs": spec.each, "metavar": ("X", "Y", "Z")[: spec.each]}
        words["help"] += "; repeatable"
    elif spec.choices:
        words["metavar"] = "|".join(spec.choices)
    else:
        words["metavar"] = (
            "LIST" if isinstance(spec.default, tuple) else "TEXT" if isinstance(spec.default, str) else "N"
        )
    group.add_argument(_flag(spec), **words)


def _flag(spec: Parameter) -> str:
    return f"--{spec.name.replace('_', '-')}"


def _place(spec: Parameter) -> str:
    """Apart from the arguments that all experiments have."""
    return f"option {spec.name}"


def _text(spec: Parameter) -> str:
    default = spec.default
    if isinstance(default, bool):
        return "on" if default else "off"
    if not isinstance(default, tuple):
        return f"{default:g}" if isinstance(default, float) else str(default) or "none"
    numbers = [f"{value:g}" for value in default]
    groups = [" ".join(numbers[place : place + spec.each]) for place in range(0, len(numbers), spec.each)]
    return ", ".join(groups)


def _typed(spec: Parameter, value: Any) -> object:
    """What was given as text in the parameter's type; text that is none of it is left to the parameter's check."""
    if spec.each > 1:
        return [_number(text, spec) for group in value for text in group]
    if isinstance(spec.default, tuple):
        return parse_numbers(value, _flag(spec), spec.unit)
    if isinstance(spec.default, int | float) and not isinstance(spec.default, bool):
        return _number(value, spec)
    return value


def _number(text: str, spec: Parameter) -> float | int:
    try:
        return int(text) if isinstance(spec.default, int) else float(text)
    except ValueError:
        kind = "a whole number" if isinstance(spec.default, int) else "a number"
        raise InputError(f"{_flag(spec)}: {text!r} is not {kind}") from None
