"""Writes docs/parameters.md from the parameters that the code declares: `.venv/bin/python tools/parameter_docs.py`."""

from __future__ import annotations

from pathlib import Path

from pkm_cnc.config import AXIS_SECTIONS, ControllerParameters, GraphParameters
from pkm_cnc.kinematics import load_kinematics, machine_names
from pkm_cnc.motion import MotionParameters
from pkm_cnc.nodes.ros_parameters import RunParameters
from pkm_cnc.parameters import Parameter, parameters_of
from pkm_cnc.program import ProgramParameters

DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "parameters.md"

HEAD = """# Parameters

Keys of a machine file (`config/*.yaml`), of `--set KEY=VALUE` and of the nodes; SI units. Written by
`tools/parameter_docs.py` from the code. Parameters of the sections drive, screw, scale and travel can be given for one
axis by putting it in front: `u1.drive.kv`. Whole numbers stand for numbers where a number is asked for.
"""


def document() -> str:
    """The document's text."""
    names = ", ".join(machine_names())
    parts = [HEAD, _section("General", "", ControllerParameters, f"`machine` names the kinematics, one of {names}.")]
    for name in machine_names():
        parts.append(_section(f"geometry ({name})", "geometry.", load_kinematics(name).Geometry))
    parts.append(_section("program", "program.", ProgramParameters))
    parts.append(_section("motion", "motion.", MotionParameters))
    parts += [_section(f"{name} (per axis)", f"{name}.", section) for name, section in AXIS_SECTIONS.items()]
    parts.append(_section("graph", "graph.", GraphParameters))
    remark = "Given to a node beside those of the machine (`-p KEY:=VALUE`), never in a machine file."
    parts.append(_section("Of a run", "", RunParameters, remark))
    return "\n".join(parts)


def _section(title: str, prefix: str, section: type, remark: str = "") -> str:
    lines = [f"## {title}", "", *([remark, ""] if remark else [])]
    lines += ["| key | default | unit | bounds | meaning |", "|---|---|---|---|---|"]
    lines += [_row(prefix, spec) for spec in parameters_of(section)]
    return "\n".join([*lines, ""])


def _row(prefix: str, spec: Parameter) -> str:
    default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
    return f"| `{prefix}{spec.name}` | {default} | {spec.unit} | {_bounds(spec)} | {spec.doc} |"


def _bounds(spec: Parameter) -> str:
    if spec.choices:
        return ", ".join(spec.choices)
    bounds = {"above": spec.above, "from": spec.minimum, "to": spec.maximum}
    return ", ".join(f"{word} {bound:g}" for word, bound in bounds.items() if bound is not None)


if __name__ == "__main__":
    DOCUMENT.write_text(document(), encoding="utf-8")
