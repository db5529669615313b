"""Looking at results: error fields and episodes as Rerun recordings, figures, pages of runs.

    env = LogRerun(gymnasium.make("pickenv/Reach-v0"), "runs/recordings", policy="scripted")    # episodes
    inspect_calibration(calibration, plant, "runs/calibration.rrd")                             # error fields
    write_drawings(drawings_of(read_run("runs/demo")), Path("figures"))                         # a run's figures
    html = page_of(read_run("runs/demo"))                                                       # and its report

rerun and matplotlib are loaded when a function that needs them is first asked for.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv.inspect.figures.run_drawings import comparison_drawings, trace_drawings, write_drawings
    from pickenv.inspect.figures.style import save_figure
    from pickenv.inspect.films.make_film import film
    from pickenv.inspect.recordings.comparison_recording import record_comparison
    from pickenv.inspect.recordings.harvest_recording import inspect_harvest
    from pickenv.inspect.recordings.inspections import inspect_calibration, inspect_evaluation
    from pickenv.inspect.recordings.log_rerun import LogRerun, LogRerunVector
    from pickenv.inspect.reports.calibration_report import write_calibration_report
    from pickenv.inspect.reports.run_pages import drawings_of, page_of
    from pickenv.inspect.runs.comparison_summary import Comparison, PolicyErrors
    from pickenv.inspect.runs.run_folder import Run, read_run

__all__ = ["Comparison", "LogRerun", "LogRerunVector", "PolicyErrors", "Run", "comparison_drawings", "drawings_of"]
__all__ += [
    "film",
    "inspect_calibration",
    "inspect_evaluation",
    "inspect_harvest",
    "page_of",
    "read_run",
    "record_comparison",
]
__all__ += ["save_figure", "trace_drawings", "write_calibration_report", "write_drawings"]

__getattr__, __dir__ = _offered(__name__)
