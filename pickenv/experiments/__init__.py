"""Experiments: units × factors → rows → numbers with intervals; tolerance studies among them.

    experiment = Experiment("gains", {"arm": range(20)}, {"method": ("raw", "ls")}, measure, seed=0)
    rows = run(experiment, "runs/gains", backend="loky")              # kept piece by piece; what was cut off goes on
    estimate(rows.columns, "error_mm", by=("method",), over=("arm",))  # a mean over arms, with its 95 % interval

A tolerance study draws, calibrates and sends to fruit a population of arms: what share of them is good enough?

    study = load_study("scripts/tolerance_study.toml").quick()
    summary = run_study(study, Path("runs/study"), executor="batched")        # goes on where it was stopped
    table = yields_of(read_rows("runs/study"), study.share)                   # arms within specification, by setting
    write_outputs("runs/study")                                               # figures, report.html, arms.rrd
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv.experiments.engine import Experiment, Rows, check_experiment, keep, kept_rows, run
    from pickenv.experiments.methods import CalibrationPlan, calibrate_arm, reaches_behind
    from pickenv.experiments.policies import PolicySettings, run_policies
    from pickenv.experiments.policy_tables import compensations_compared, estimates, evaluation_rows
    from pickenv.experiments.study import StudyConfig, load_study
    from pickenv.experiments.study_report import record_study, write_outputs
    from pickenv.experiments.study_rows import (
        check_folder,
        quantiles_of,
        read_rows,
        read_summary,
        run_study,
        study_of,
        yields_of,
    )
    from pickenv.experiments.study_variance import sensitivities_of
    from pickenv.intervals import Estimate, estimate

__all__ = ["CalibrationPlan", "Estimate", "Experiment", "PolicySettings", "Rows", "calibrate_arm", "check_experiment"]
__all__ += ["compensations_compared", "estimate", "estimates", "evaluation_rows", "keep", "kept_rows"]
__all__ += ["reaches_behind", "run", "run_policies"]
__all__ += ["StudyConfig", "check_folder", "load_study", "quantiles_of", "read_rows", "read_summary", "record_study"]
__all__ += ["run_study", "sensitivities_of", "study_of", "write_outputs", "yields_of"]

__getattr__, __dir__ = _offered(__name__)
