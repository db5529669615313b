from .figures.run_drawings import (
    comparison_drawings as comparison_drawings,
    trace_drawings as trace_drawings,
    write_drawings as write_drawings,
)
from .figures.style import save_figure as save_figure
from .films.make_film import film as film
from .recordings.comparison_recording import record_comparison as record_comparison
from .recordings.harvest_recording import inspect_harvest as inspect_harvest
from .recordings.inspections import inspect_calibration as inspect_calibration, inspect_evaluation as inspect_evaluation
from .recordings.log_rerun import LogRerun as LogRerun, LogRerunVector as LogRerunVector
from .reports.calibration_report import write_calibration_report as write_calibration_report
from .reports.report_page import drawings_of as drawings_of, page_of as page_of
from .runs.recorded_episodes import (
    Comparison as Comparison,
    Reaches as Reaches,
    RecordedEpisodes as RecordedEpisodes,
    RecordedPolicy as RecordedPolicy,
)
from .runs.run_folder import Run as Run, read_run as read_run
