"""What people read: tables, pictures and pages, in mm, um and mm/min.

A figure is described once (`Figure`) and drawn for paper and for the screen; `write_page` writes both.
"""

from pkm_cnc.report.figure import Curve, Figure, Map, Note, Panel, Table, round_scale
from pkm_cnc.report.files import write_whole
from pkm_cnc.report.page import Page, write_page
from pkm_cnc.report.run_report import parameter_tables, run_figures, run_page
from pkm_cnc.report.tables import run_headline, run_remarks, run_tables
from pkm_cnc.report.text import text_table

__all__ = [
    "Curve",
    "Figure",
    "Map",
    "Note",
    "Page",
    "Panel",
    "Table",
    "parameter_tables",
    "round_scale",
    "run_figures",
    "run_headline",
    "run_page",
    "run_remarks",
    "run_tables",
    "text_table",
    "write_page",
    "write_whole",
]
