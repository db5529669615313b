"""Experiments: units × factors → rows → numbers with intervals.

experiment = Experiment("gains", {"arm": range(20)}, {"method": ("raw", "ls")}, measure, seed=0)
rows = run(experiment, "runs/gains", backend="loky")              # kept piece by piece; what was cut off goes on
estimate(rows.columns, "error_mm", by=("method",), over=("arm",))  # a mean over arms, with its 95 % interval
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv.experiments.engine import Experiment, Rows, check_experiment, keep, kept_rows, run
    from pickenv.experiments.methods import CalibrationPlan, calibrate_arm, reaches_behind
    from pickenv.experiments.policies import PolicySettings, run_policies
    from pickenv.experiments.policy_tables import compensations_compared, estimates, evaluation_rows
    from pickenv.intervals import Estimate, estimate

__all__ = ["CalibrationPlan", "Estimate", "Experiment", "PolicySettings", "Rows", "calibrate_arm", "check_experiment"]
__all__ += ["compensations_compared", "estimate", "estimates", "evaluation_rows", "keep", "kept_rows"]
__all__ += ["reaches_behind", "run", "run_policies"]

__getattr__, __dir__ = _offered(__name__)
