"""Parameters as typed, documented, bounded fields of frozen dataclasses.

A room declares what it needs as a frozen dataclass whose fields are made by `parameter`; a machine file, a command line
and a ROS parameter server are read into it by `read_section`, which names key and bound of whatever it refuses.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, TypeVar

from pkm_cnc.errors import InputError

__all__ = ["Parameter", "Value", "parameter", "parameters_of", "read_section"]

Value = bool | int | float | str | tuple[float, ...]
Section = TypeVar("Section")


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One parameter: its key in its section, default, meaning, unit and bounds (None = unbounded)."""

    name: str
    default: Value
    doc: str
    unit: str
    above: float | None
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]
    length: int | None
    """Of a tuple; None = any but 0."""
    each: int = 1
    """How many numbers of a tuple belong together: 2 in a list of points x, y."""
    decided: bool = False
    """Of a geometry: what the controller decides, so that the actual machine has none of its own."""

    def check(self, value: object, key: str) -> Value:
        """Return `value` in this parameter's type.

        Raises InputError naming `key`, the value and the bound or type it misses.
        """
        kind = type(self.default)
        if kind is float:
            value = _number(value)
        if kind is tuple and isinstance(value, (list, tuple)):
            return self._check_numbers(value, key)
        if type(value) is not kind:
            raise InputError(f"{key}: {value!r} is not {_KINDS[kind]}")
        if self.choices and value not in self.choices:
            raise InputError(f"{key}: {value!r} is not one of {', '.join(self.choices)}")
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            self._check_bounds(value, key)
        return value

    def _check_numbers(self, values: list[object] | tuple[object, ...], key: str) -> tuple[float, ...]:
        if not values:
            raise InputError(f"{key}: no numbers given")
        if self.length is not None and len(values) != self.length:
            raise InputError(f"{key}: {len(values)} numbers given, {self.length} wanted")
        if len(values) % self.each:
            raise InputError(f"{key}: {len(values)} numbers given, a multiple of {self.each} wanted")
        numbers = []
        for index, value in enumerate(values):
            number = _number(value)
            if not isinstance(number, float):
                raise InputError(f"{key}[{index}]: {value!r} is not a number")
            self._check_bounds(number, f"{key}[{index}]")
            numbers.append(number)
        return tuple(numbers)

    def _check_bounds(self, value: float, key: str) -> None:
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{key}: {value} is not a finite number")
        unit = f" {self.unit}" if self.unit else ""
        if self.above is not None and not value > self.above:
            raise InputError(f"{key}: {value}{unit} is not above {self.above}{unit}")
        if self.minimum is not None and value < self.minimum:
            raise InputError(f"{key}: {value}{unit} is below its minimum {self.minimum}{unit}")
        if self.maximum is not None and value > self.maximum:
            raise InputError(f"{key}: {value}{unit} is over its maximum {self.maximum}{unit}")


def _number(value: object) -> object:
    """A whole number, or a text that is a number, as a float: YAML 1.1 reads 1e-6 as a text; all else as it is."""
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        return value
    try:
        return float(value)
    except (ValueError, OverflowError):
        return value


_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text", tuple: "a list of numbers"}


def parameter(
    default: Value,
    doc: str,
    *,
    unit: str = "",
    above: float | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    any_length: bool = False,
    each: int = 1,
    decided: bool = False,
) -> Any:
    """A dataclass field that is a parameter: default (its type is the parameter's), meaning, unit, bounds.

    `above` is an exclusive lower bound. A tuple is a list of as many numbers, or with `any_length` of one or more, each
    within the bounds; `each` of them belong together. `decided`: by the controller, no matter of the actual machine.
    """
    length = len(default) if isinstance(default, tuple) and not any_length else None
    spec = Parameter("", default, doc, unit, above, minimum, maximum, choices, length, each, decided)
    return dataclasses.field(default=default, metadata={"parameter": spec})


def parameters_of(section: type) -> tuple[Parameter, ...]:
    """The parameters that a section (a dataclass made with `parameter` fields) declares, in order."""
    return tuple(
        dataclasses.replace(field.metadata["parameter"], name=field.name) for field in dataclasses.fields(section)
    )


def read_section(section: type[Section], values: Mapping[str, object], prefix: str) -> Section:
    """Build `section` from `values` by field name, defaults for what is missing; `prefix` names the section in errors.

    Raises InputError for an unknown key, a wrong type, a value out of bounds, or what the section itself refuses.
    """
    known = {spec.name: spec for spec in parameters_of(section)}
    for name in values:
        if name not in known:
            names = ", ".join(f"{prefix}{known_name}" for known_name in known)
            raise InputError(f"{prefix}{name}: unknown parameter; there are {names}")
    checked = {name: known[name].check(value, prefix + name) for name, value in values.items()}
    try:
        return section(**checked)
    except InputError as error:  # begins with the key in the section
        raise InputError(f"{prefix}{error}") from None
