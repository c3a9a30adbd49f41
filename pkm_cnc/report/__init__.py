"""What people read: tables and pictures, in mm, um and mm/min."""

from pkm_cnc.report.pictures import draw
from pkm_cnc.report.tables import table
from pkm_cnc.report.text import text_table

__all__ = ["draw", "table", "text_table"]
