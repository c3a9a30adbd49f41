"""The compensation preprocessor (thesis chapter 7): a part program in, a compensated part program out.

`compensate` is the door; docs/compensation.md tells the idea and the methods.
"""

from pkm_cnc.compensation.methods import METHODS
from pkm_cnc.compensation.nominal import model_of, nominal
from pkm_cnc.compensation.observation import ErrorFigures, judged, observe
from pkm_cnc.compensation.preprocessor import Compensated, CompensationOptions, Pass, compensate

__all__ = [
    "METHODS",
    "Compensated",
    "CompensationOptions",
    "ErrorFigures",
    "Pass",
    "compensate",
    "judged",
    "model_of",
    "nominal",
    "observe",
]
