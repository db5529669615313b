"""Inspection: a comparison of policies as a Rerun recording and as figures; rerun and matplotlib load when used."""

from pickenv.inspect.comparison import Comparison, PolicyErrors
from pickenv.inspect.recording import record_comparison

__all__ = ["Comparison", "PolicyErrors", "record_comparison"]
