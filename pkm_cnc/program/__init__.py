"""Part programs: text -> blocks -> modal state -> toolpath (lines and arcs in `base_link`, SI)."""

from pkm_cnc.program.arcs import ArcFeed
from pkm_cnc.program.blocks import Program, ProgramError, program_from_bytes, read_program
from pkm_cnc.program.canon import canonical_events, canonical_motion
from pkm_cnc.program.frames import frames
from pkm_cnc.program.interpreter import (
    NOT_EVALUATED_COMMENT,
    Motion,
    ProgramParameters,
    interpret,
    read_elements,
    read_motions,
)
from pkm_cnc.program.original import carried_original, carry_original, element_comment, with_reference
from pkm_cnc.program.source import ProgramSource, approach
from pkm_cnc.program.toolpath import (
    EXACT_PATH,
    Arc,
    Element,
    Event,
    EventKind,
    Frame,
    Line,
    Numbering,
    PathMode,
    Place,
    Plane,
    Spot,
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
    "Frame",
    "Line",
    "Motion",
    "Numbering",
    "PathMode",
    "Place",
    "Plane",
    "Program",
    "ProgramError",
    "ProgramParameters",
    "ProgramSource",
    "Spot",
    "Toolpath",
    "Totals",
    "approach",
    "canonical_events",
    "canonical_motion",
    "carried_original",
    "carry_original",
    "element_comment",
    "frames",
    "interpret",
    "program_from_bytes",
    "read_elements",
    "read_motions",
    "read_program",
    "with_reference",
]
