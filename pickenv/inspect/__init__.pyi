from .colours import between as between, estimated as estimated, in_words as in_words, percent as percent
from .figures.plot_calibration import (
    joint_coverage as joint_coverage,
    least_squares_convergence as least_squares_convergence,
    network_convergence as network_convergence,
    parameter_spectrum as parameter_spectrum,
    uncertainty_map as uncertainty_map,
)
from .figures.plot_errors import (
    corner_errors as corner_errors,
    error_against as error_against,
    error_by_method as error_by_method,
    error_cumulative as error_cumulative,
    error_fields as error_fields,
    error_histogram as error_histogram,
    error_per_pose as error_per_pose,
    error_slices as error_slices,
    view_errors as view_errors,
)
from .figures.plot_harvest import (
    funnel_bars as funnel_bars,
    gantt as gantt,
    joint_displacements as joint_displacements,
    pick_map as pick_map,
    throughput_by_arms as throughput_by_arms,
    workspace_cloud as workspace_cloud,
)
from .figures.plot_policies import (
    accuracy_against_cycle_time as accuracy_against_cycle_time,
    accuracy_by_pose as accuracy_by_pose,
    accuracy_drift as accuracy_drift,
    aggregates as aggregates,
    error_by_condition as error_by_condition,
    estimates_figure as estimates_figure,
    success_against_misalignment as success_against_misalignment,
)
from .figures.run_drawings import (
    Drawing as Drawing,
    comparison_drawings as comparison_drawings,
    trace_drawings as trace_drawings,
    write_drawings as write_drawings,
)
from .figures.style import new_figure as new_figure, save_figure as save_figure
from .films.film import film as film
from .recordings.comparison_recording import (
    inspect_calibration as inspect_calibration,
    inspect_evaluation as inspect_evaluation,
    record_comparison as record_comparison,
)
from .recordings.harvest_recording import inspect_harvest as inspect_harvest
from .recordings.log_rerun import LogRerun as LogRerun, LogRerunVector as LogRerunVector
from .reports.calibration_report import (
    calibration_page as calibration_page,
    write_calibration_report as write_calibration_report,
)
from .reports.report_page import (
    PageTable as PageTable,
    PageVerdict as PageVerdict,
    Section as Section,
    drawings_of as drawings_of,
    html_of as html_of,
    page_of as page_of,
    plain_report as plain_report,
)
from .runs.comparison_summary import (
    gripped as gripped,
    gripper_curves as gripper_curves,
    matters as matters,
    pick_changes as pick_changes,
)
from .runs.recorded_episodes import (
    Comparison as Comparison,
    FieldGrid as FieldGrid,
    Reaches as Reaches,
    RecordedEpisodes as RecordedEpisodes,
    RecordedPolicy as RecordedPolicy,
    ended as ended,
    field_grid as field_grid,
    reaches_of as reaches_of,
)
from .runs.run_folder import (
    Run as Run,
    load_part as load_part,
    read_run as read_run,
    recorded_run as recorded_run,
    run_kind as run_kind,
    save_part as save_part,
)
from .runs.traces import (
    CalibrationTrace as CalibrationTrace,
    HarvestTrace as HarvestTrace,
    PickedTree as PickedTree,
    picked_tree as picked_tree,
    trace_of as trace_of,
)
