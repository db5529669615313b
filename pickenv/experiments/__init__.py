"""Run experiments and estimate numbers with 95 % intervals from their rows; tolerance studies are experiments too.

An experiment measures units that were drawn, such as arms, at every combination of its factors:

    experiment = Experiment("gains", {"arm": range(20)}, {"method": ("raw", "ls")}, measure, seed=0)
    rows = run(experiment, "runs/gains", backend="loky")              # keeps its results; an interrupted run continues
    estimate(rows.columns, "error_mm", by=("method",), over=("arm",))  # a mean over arms, with its 95 % interval

A tolerance study draws a population of arms, calibrates each arm and sends it to fruit. It estimates the yield, that
is the share of arms within specification:

    study = load_study("scripts/tolerance_study.toml").quick()
    summary = run_study(study, Path("runs/study"), executor="batched")        # continues an interrupted study
    table = yields_of(read_rows("runs/study"), study.share)                   # the yield of every setting
    write_outputs("runs/study")                                               # figures, report.html, arms.rrd
"""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.experiments", __file__)
