"""Inspection: a comparison of policies as a Rerun recording and as figures; rerun and matplotlib load when used."""

from pickenv.inspect.recordings.comparison_recording import record_comparison
from pickenv.inspect.recordings.inspections import inspect_calibration, inspect_evaluation
from pickenv.inspect.recordings.log_rerun import LogRerun, LogRerunVector
from pickenv.inspect.runs.comparison import Comparison, PolicyErrors

__all__ = [
    "Comparison",
    "LogRerun",
    "LogRerunVector",
    "PolicyErrors",
    "inspect_calibration",
    "inspect_evaluation",
    "record_comparison",
]
