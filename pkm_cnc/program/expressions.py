"""What stands for a number in a block: numbers, parameters, expressions, functions (NIST RS274/NGC version 3, 3.3.2).

    value      = [+ or -] (number | #parameter | [expression] | FUNCTION[expression] | ATAN[expression]/[expression])
    parameter  = value | <name>
    expression = value {operator value}

Angles are in degrees. Operators bind in this order, those of one row from left to right: `**`; `*` `/` `MOD`; `+` `-`;
`EQ` `NE` `GT` `GE` `LT` `LE`; `AND` `OR` `XOR`. True is 1, false 0, and what is not 0 counts as true. EQ and NE take
numbers less than 1e-6 apart as equal, as LinuxCNC does.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from pkm_cnc.program.parameters import Key, ParameterError, Parameters

__all__ = ["MalformedError", "Reader"]

DEEPEST_NESTING = 50
"""Brackets within brackets, and # of #: no block needs so many, and it bounds the recursion here."""
EQUAL = 1e-6
WHOLE = 1e-4
"""A number this close to a whole one is meant to be it (NIST RS274/NGC, 3.3.2.1)."""

_NUMBER = re.compile(r"[0-9]+\.?[0-9]*|\.[0-9]+")
_NAME = re.compile(r"<([^<>\[\]#=]+)>")
_FUNCTION = re.compile(r"ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN")
_OPERATOR = re.compile(r"\*\*|[-+*/]|MOD|EQ|NE|GT|GE|LT|LE|AND|OR|XOR")


class MalformedError(Exception):
    """A block that cannot be read; the text says why."""


def _round(x: float) -> float:
    return math.copysign(math.floor(abs(x) + 0.5), x)


def _modulo(a: float, b: float) -> float:
    rest = math.fmod(a, b)
    return rest + abs(b) if rest < 0.0 else rest


_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "ABS": abs,
    "ACOS": lambda x: math.degrees(math.acos(x)),
    "ASIN": lambda x: math.degrees(math.asin(x)),
    "COS": lambda x: math.cos(math.radians(x)),
    "EXP": math.exp,
    "FIX": lambda x: float(math.floor(x)),
    "FUP": lambda x: float(math.ceil(x)),
    "LN": math.log,
    "ROUND": _round,
    "SIN": lambda x: math.sin(math.radians(x)),
    "SQRT": math.sqrt,
    "TAN": lambda x: math.tan(math.radians(x)),
}
_OPERATORS: dict[str, tuple[int, Callable[[float, float], float]]] = {
    "**": (5, math.pow),
    "*": (4, lambda a, b: a * b),
    "/": (4, lambda a, b: a / b),
    "MOD": (4, _modulo),
    "+": (3, lambda a, b: a + b),
    "-": (3, lambda a, b: a - b),
    "EQ": (2, lambda a, b: float(abs(a - b) < EQUAL)),
    "NE": (2, lambda a, b: float(not abs(a - b) < EQUAL)),
    "GT": (2, lambda a, b: float(a > b)),
    "GE": (2, lambda a, b: float(a >= b)),
    "LT": (2, lambda a, b: float(a < b)),
    "LE": (2, lambda a, b: float(a <= b)),
    "AND": (1, lambda a, b: float(a != 0.0 and b != 0.0)),
    "OR": (1, lambda a, b: float(a != 0.0 or b != 0.0)),
    "XOR": (1, lambda a, b: float((a != 0.0) != (b != 0.0))),
}


class Reader:
    """Reads values from `code`, a block's text without blanks and comments, in upper case, and keeps the place."""

    def __init__(self, code: str, parameters: Parameters) -> None:
        self.code = code
        self.place = 0
        self._parameters = parameters
        self._depth = 0

    @property
    def at_end(self) -> bool:
        """Whether all is read."""
        return self.place >= len(self.code)

    def next_is(self, text: str) -> bool:
        """Whether `text` comes next."""
        return self.code.startswith(text, self.place)

    def take(self, text: str) -> bool:
        """Pass over `text` if it comes next, and tell whether it did."""
        if self.code.startswith(text, self.place):
            self.place += len(text)
            return True
        return False

    def value(self) -> float:
        """Read a value. Raises MalformedError for what is none, or not a finite number."""
        sign = -1.0 if self.take("-") else 1.0
        if sign > 0.0:
            self.take("+")
        return sign * self._unsigned()

    def bracketed(self) -> float:
        """Read `[expression]`."""
        if not self.take("["):
            raise MalformedError(f"'[' wanted before {self._rest()}")
        self._enter()
        value = self._expression(1)
        self._depth -= 1
        if not self.take("]"):
            raise MalformedError(
                "expression without ']'" if self.at_end else f"operator or ']' wanted before {self._rest()}"
            )
        return value

    def parameter(self) -> Key:
        """Read what stands behind a `#`: the number or the name of a parameter."""
        named = _NAME.match(self.code, self.place)
        if named:
            self.place = named.end()
            return named.group(1)
        self._enter()
        number = self._unsigned()
        self._depth -= 1
        if abs(number - round(number)) > WHOLE:
            raise MalformedError(f"parameter number {number:g} is not a whole number")
        return round(number)

    def _unsigned(self) -> float:
        number = _NUMBER.match(self.code, self.place)
        if number:
            self.place = number.end()
            return _finite(float(number.group()), number.group())
        if self.take("#"):
            key = self.parameter()
            try:
                return self._parameters.get(key)
            except ParameterError as error:
                raise MalformedError(str(error)) from None
        if self.next_is("["):
            return self.bracketed()
        function = _FUNCTION.match(self.code, self.place)
        if function:
            self.place = function.end()
            return self._function(function.group())
        raise MalformedError(f"number wanted before {self._rest()}")

    def _function(self, name: str) -> float:
        if name == "EXISTS":
            named = re.compile(r"\[#<([^<>\[\]#=]+)>\]").match(self.code, self.place)
            if not named:
                raise MalformedError("EXISTS takes the name of a parameter: EXISTS[#<name>]")
            self.place = named.end()
            return float(self._parameters.exists(named.group(1)))
        x = self.bracketed()
        if name == "ATAN":
            if not self.take("/"):
                raise MalformedError("ATAN takes two numbers: ATAN[y]/[x]")
            return math.degrees(math.atan2(x, self.bracketed()))
        return _computed(f"{name}[{x:g}]", _FUNCTIONS[name], x)

    def _expression(self, lowest: int) -> float:
        value = self.value()
        while True:
            operator = _OPERATOR.match(self.code, self.place)
            if not operator:
                return value
            name = operator.group()
            rank, compute = _OPERATORS[name]
            if rank < lowest:
                return value
            self.place = operator.end()
            other = self._expression(rank + 1)
            value = _computed(f"{value:g} {name} {other:g}", compute, value, other)

    def _enter(self) -> None:
        self._depth += 1
        if self._depth > DEEPEST_NESTING:
            raise MalformedError(f"more than {DEEPEST_NESTING} brackets within each other")

    def _rest(self) -> str:
        return repr(self.code[self.place : self.place + 20]) if not self.at_end else "the end of the block"


def _computed(spelled: str, compute: Callable[..., float], *arguments: float) -> float:
    try:
        return _finite(compute(*arguments), spelled)
    except (ValueError, OverflowError, ZeroDivisionError):
        raise MalformedError(f"{spelled} has no finite value") from None


def _finite(value: float, spelled: str) -> float:
    if not math.isfinite(value):
        raise MalformedError(f"{spelled[:40]} has no finite value")
    return value
