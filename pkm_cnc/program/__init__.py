"""Part programs: text -> blocks -> modal state -> toolpath (lines and arcs in `base_link`, SI)."""

from pkm_cnc.program.arcs import ArcFeed
from pkm_cnc.program.blocks import Program, ProgramError, program_from_bytes, read_program
from pkm_cnc.program.canon import canonical_events, canonical_motion
from pkm_cnc.program.interpreter import (
    NOT_EVALUATED_COMMENT,
    Motion,
    ProgramParameters,
    interpret,
    read_elements,
    read_motions,
)
from pkm_cnc.program.source import ProgramSource, approach
from pkm_cnc.program.toolpath import (
    EXACT_PATH,
    Arc,
    Element,
    Event,
    EventKind,
    Line,
    PathMode,
    Plane,
    Toolpath,
    Totals,
)

__all__ = [
    "EXACT_PATH",
    "NOT_EVALUATED_COMMENT",
    "Arc",
    "ArcFeed",
    "Element",
    "Event",
    "EventKind",
    "Line",
    "Motion",
    "PathMode",
    "Plane",
    "Program",
    "ProgramError",
    "ProgramParameters",
    "ProgramSource",
    "Toolpath",
    "Totals",
    "approach",
    "canonical_events",
    "canonical_motion",
    "interpret",
    "program_from_bytes",
    "read_elements",
    "read_motions",
    "read_program",
]
