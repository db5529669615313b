"""Tolerance studies: populations of arms, each drawn, calibrated and sent to fruit; what share of them is good enough.

    study = load_study("scripts/tolerance_study.toml").quick()
    summary = run_study(study, Path("runs/study"), executor="batched")        # goes on where it was stopped
    table = yields_of(read_rows("runs/study"), study.share)                   # arms within specification, by setting
    write_outputs("runs/study")                                               # figures, report.html, arms.rrd

A study is a list of settings; every setting is run on the same arms, fruit and calibration poses. Chunks of arms go to
an executor, their rows into a Parquet data set that a killed study resumes from.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv.study.analysis.sensitivity import sensitivities_of
    from pickenv.study.analysis.study_recording import record_study
    from pickenv.study.analysis.study_report import write_outputs
    from pickenv.study.design.config import StudyConfig, load_study
    from pickenv.study.results.quantiles import quantiles_of, yields_of
    from pickenv.study.results.study_folder import check_folder, read_rows, read_summary, study_of
    from pickenv.study.running.run_study import run_study
    from pickenv.study.running.runners import Crew

__all__ = ["Crew", "StudyConfig", "check_folder", "load_study", "quantiles_of", "read_rows", "read_summary"]
__all__ += ["record_study", "run_study", "sensitivities_of", "study_of", "write_outputs", "yields_of"]

__getattr__, __dir__ = _offered(__name__)
