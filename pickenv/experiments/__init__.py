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

from pickenv.base.faces import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.experiments", __file__)
