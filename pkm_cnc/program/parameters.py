"""The parameters of a part program: `#5`, `#<name>` (of a subroutine), `#<_name>` (of the whole program).

As in LinuxCNC: #1 to #30 are those of the running subroutine, #31 to #5000 of the whole program; a numbered parameter
that was not set is 0, a named one is an error. Above 5000, and under some names, stand what the interpreter knows
(position, offsets, feed): they are only read, and those it does not know are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

__all__ = ["LOCAL_NUMBERS", "ParameterError", "Parameters"]

LOCAL_NUMBERS = 30
"""#1 to this one belong to the running subroutine."""
LAST_NUMBER = 5000
"""The last numbered parameter that a program may set."""

Key = int | str
"""A number, or a name without its <> and blanks, in upper case."""


class ParameterError(Exception):
    """A parameter that cannot be read or set; the text says why."""


class Parameters:
    """Numbered and named parameters. `known` are those that are only read, by key, each a function of no argument."""

    returned: float | None
    """What the last subroutine returned, None = nothing: #<_value>, #<_value_returned>."""

    line: int
    """The line that is read: #<_line>."""

    def __init__(self, known: Mapping[Key, Callable[[], float]]) -> None:
        self.returned = None
        self.line = 0
        self._known: dict[Key, Callable[[], float]] = {
            **known,
            "_LINE": lambda: float(self.line),
            "_VALUE": lambda: self.returned or 0.0,
            "_VALUE_RETURNED": lambda: float(self.returned is not None),
        }
        self._values: dict[Key, float] = {}
        self._locals: list[dict[Key, float]] = [{}]

    def get(self, key: Key) -> float:
        """The value of a parameter. Raises ParameterError for one that is not there."""
        values = self._home(key)
        if key in values:
            return values[key]
        if key in self._known:
            return self._known[key]()
        if isinstance(key, str):
            raise ParameterError(f"parameter #<{key.lower()}> was not set before")
        if not 1 <= key <= LAST_NUMBER:
            raise ParameterError(
                f"parameter #{key} is none of those that can be read: #1 to #{LAST_NUMBER}, {self._which()}"
            )
        return 0.0

    def exists(self, name: str) -> bool:
        """Whether a named parameter has a value."""
        return name in self._home(name) or name in self._known

    def set(self, key: Key, value: float) -> None:
        """Give a parameter a value. Raises ParameterError for one that is only read."""
        spelled = f"#<{key.lower()}>" if isinstance(key, str) else f"#{key}"
        if key in self._known:
            raise ParameterError(f"parameter {spelled} is only read")
        if isinstance(key, int) and not 1 <= key <= LAST_NUMBER:
            raise ParameterError(f"parameter {spelled} cannot be set: only #1 to #{LAST_NUMBER}")
        self._home(key)[key] = value

    def enter(self, arguments: list[float]) -> None:
        """Begin a subroutine: its #1, #2, ... are the arguments, the rest to #30 keep the caller's values."""
        numbered: dict[Key, float] = {key: value for key, value in self._locals[-1].items() if isinstance(key, int)}
        numbered.update(enumerate(arguments, start=1))
        self._locals.append(numbered)

    def leave(self) -> None:
        """End a subroutine: the caller's #1 to #30 and names are back."""
        self._locals.pop()

    def _home(self, key: Key) -> dict[Key, float]:
        is_global = key.startswith("_") if isinstance(key, str) else key > LOCAL_NUMBERS
        return self._values if is_global else self._locals[-1]

    def _which(self) -> str:
        return ", ".join(f"#{key}" for key in sorted(key for key in self._known if isinstance(key, int)))
