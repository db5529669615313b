"""Display of results: Rerun recordings of error fields and episodes, figures, and HTML reports of runs.

    env = LogRerun(gymnasium.make("pickenv/Reach-v0"), "runs/recordings", policy="scripted")    # episodes
    inspect_calibration(calibration, plant, "runs/calibration.rrd")                             # error fields
    write_drawings(drawings_of(read_run("runs/demo")), Path("figures"))                         # a run's figures
    html = page_of(read_run("runs/demo"))                                                       # and its report

rerun and matplotlib are imported when a function that needs them is first used.
"""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.inspect", __file__)
