from .engine import (
    Estimate as Estimate,
    Experiment as Experiment,
    Rows as Rows,
    check_experiment as check_experiment,
    estimate as estimate,
    joined as joined,
    keep as keep,
    kept_rows as kept_rows,
    run as run,
    spread as spread,
    write_rows as write_rows,
)
from .experiment_file import load_experiment as load_experiment
from .gains import measured_gains as measured_gains
from .methods import (
    CalibrationPlan as CalibrationPlan,
    calibrate_arm as calibrate_arm,
    compensators as compensators,
    reaches_behind as reaches_behind,
)
from .policies import PolicySettings as PolicySettings, run_policies as run_policies
from .policy_tables import (
    compensations_compared as compensations_compared,
    estimates as estimates,
    evaluation_rows as evaluation_rows,
)
from .robots import SETS as SETS, BenchSettings as BenchSettings, run_bench as run_bench
from .study import (
    Noise as Noise,
    StudyConfig as StudyConfig,
    load_study as load_study,
    prepared_study as prepared_study,
)
from .study_findings import gather as gather
from .study_report import record_study as record_study, write_outputs as write_outputs
from .study_rows import (
    check_folder as check_folder,
    quantiles_of as quantiles_of,
    read_rows as read_rows,
    read_summary as read_summary,
    run_study as run_study,
    study_of as study_of,
    table_sha256 as table_sha256,
    yields_of as yields_of,
)
from .study_variance import sensitivities_of as sensitivities_of
