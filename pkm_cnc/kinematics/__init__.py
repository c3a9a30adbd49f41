"""Kinematics: how the joints of a machine and its TCP move each other, one module per machine.

A machine is one module `<name>.py` here with one public class `<Name>` that follows the `Machine` protocol; it is
loaded by its name and nothing else needs an edit. No machines are `machine` (the protocol) and the modules with an
underscore, which are what machines are made of.
"""

import importlib
import pkgutil
from typing import cast

from pkm_cnc.errors import InputError
from pkm_cnc.kinematics._in_space import in_space
from pkm_cnc.kinematics.machine import NOT_AS_DRAWN, Machine, Motion, Violation, is_drawn, reached_rows

__all__ = [
    "NOT_AS_DRAWN",
    "Machine",
    "Motion",
    "Violation",
    "in_space",
    "is_drawn",
    "load_kinematics",
    "machine_names",
    "reached_rows",
]


def machine_names() -> list[str]:
    """The names of all machines there are, in alphabetical order."""
    return sorted(
        module.name for module in pkgutil.iter_modules(__path__) if module.name != "machine" and module.name[0] != "_"
    )


def load_kinematics(name: str) -> type[Machine]:
    """The class of the machine called `name`: `Tripod` of `pkm_cnc.kinematics.tripod` for "tripod".

    Raises InputError, listing the machines there are, if there is none of that name.
    """
    if name not in machine_names():
        raise InputError(f"kinematics: {name!r} is unknown; there are {', '.join(machine_names())}")
    module = importlib.import_module(f"{__name__}.{name}")
    return cast(type[Machine], getattr(module, name.capitalize()))
