"""Experiments: units × factors → rows → numbers with intervals.

experiment = Experiment("gains", {"arm": range(20)}, {"method": ("raw", "ls")}, measure, seed=0)
rows = run(experiment, "runs/gains", backend="loky")              # kept piece by piece; what was cut off goes on
estimate(rows.columns, "error_mm", by=("method",), over=("arm",))  # a mean over arms, with its 95 % interval
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv.experiments.engine import Experiment, Rows, check_experiment, keep, kept_rows, run
    from pickenv.intervals import Estimate, estimate

__all__ = ["Estimate", "Experiment", "Rows", "check_experiment", "estimate", "keep", "kept_rows", "run"]

__getattr__, __dir__ = _offered(__name__)
