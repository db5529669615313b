"""Inspection: a comparison of policies as a Rerun recording and as figures; rerun and matplotlib load when used."""

from pickenv.inspect.comparison import Comparison, PolicyErrors
from pickenv.inspect.inspections import inspect_calibration, inspect_evaluation
from pickenv.inspect.log_rerun import LogRerun, LogRerunVector
from pickenv.inspect.recording import record_comparison

__all__ = [
    "Comparison",
    "LogRerun",
    "LogRerunVector",
    "PolicyErrors",
    "inspect_calibration",
    "inspect_evaluation",
    "record_comparison",
]
