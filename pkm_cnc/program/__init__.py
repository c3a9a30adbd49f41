"""Part programs: text -> blocks -> modal state -> toolpath (lines and arcs in `base_link`, SI)."""

from pkm_cnc.program.blocks import Block, Program, ProgramError, read_blocks, read_program
from pkm_cnc.program.interpreter import NOT_EVALUATED_COMMENT, canonical_motion, interpret, read_motions
from pkm_cnc.program.toolpath import Arc, Element, Line, Toolpath

__all__ = [
    "NOT_EVALUATED_COMMENT",
    "Arc",
    "Block",
    "Element",
    "Line",
    "Program",
    "ProgramError",
    "Toolpath",
    "canonical_motion",
    "interpret",
    "read_blocks",
    "read_motions",
    "read_program",
]
