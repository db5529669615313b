"""The rooms of `mutants`: which lines make numbers, and which tests should notice a change in them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Room:
    """Lines that make numbers, and the tests that should notice a change in them.

    Attributes:
        sources: Modules, without ``.py``.
        tests: Test modules, without ``test_`` and ``.py``, quickest first.
        most: How many of its mutants are tried, at random, unless a run says otherwise.
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]
    most: int


CORE, SECOND, OTHER = 40, 10, 3
"""Mutants of rooms that every number goes through, of those behind what a calibration says of itself, and of others."""


def room(sources: str, modules: str, tests: str, names: str, most: int = OTHER) -> Room:
    """A room from folder and names of its modules, and of its tests."""
    return Room(
        tuple((Path(sources) / f"{name}.py").as_posix() for name in modules.split()),
        tuple(f"{tests}/{Path(name).parent / f'test_{Path(name).name}.py'}" for name in names.split()),
        most,
    )


ROOMS = {
    "kinematics": room(
        "pickenv/arm/kinematics",
        "forward task_space pose_error",
        "tests/arm",
        "kinematics/pose_error kinematics/kinematics kinematics/jacobians kinematics/geometry kinematics/executors "
        "kinematics/random_chains plant/gravity_referee kinematics/mimic",
        most=CORE,
    ),
    "plant": room(
        "pickenv/arm",
        "plant/plant effects/structure effects/drives effects/hysteresis effects/ground",
        "tests/arm",
        "plant/plant effects/effects effects/backlash effects/thermal effects/ground effects/settling "
        "kinematics/executors plant/orchard_preset plant/gravity_referee",
        most=CORE,
    ),
    "least squares": room(
        "calibration",
        "identification/least_squares model/arm_model",
        "tests/calibration",
        "identification/stop_rule identification/enough_poses identification/second_rank identification/least_squares "
        "model/identifiability model/observations identification/align",
        most=CORE,
    ),
    "compensation": room(
        "calibration",
        "compensation/compensator pipeline/apply",
        "tests/calibration",
        "compensation/truncated_solve pipeline/apply compensation/compensation",
        most=CORE,
    ),
    "reward": room(
        "pickenv/envs/shared",
        "simulation task",
        "tests/envs",
        "reach_by_hand reach compensation_wrapper registered vector",
        most=CORE,
    ),
    "picking": room(
        "pickenv/harvester",
        "picking work harvest",
        "tests/harvester",
        "picking assignment interference harvest environments",
    ),
    "picking env": room(
        "pickenv/envs/picking",
        "pick pick_arm pick_batch pick_scene pick_vector fruit_table",
        "tests/envs/picking",
        "pick_by_hand pick_canopy pick pick_vector",
    ),
    "harvesting env": room(
        "pickenv/envs/harvesting",
        "harvest_batch harvest_env harvest_vector",
        "tests",
        "envs/harvest_by_hand harvester/harvest_vector harvester/one_cup",
    ),
    "reaching": room(
        "pickenv/envs/reaching",
        "batch torch_batch vector",
        "tests/envs",
        "autoreset streams compensation_vector vector",
    ),
    "wrappers": room(
        "pickenv/wrappers", "compensation sb3", "tests/envs", "compensation_wrapper compensation_vector sb3"
    ),
    "gap": room(
        "pickenv/wrappers",
        "gap mujoco_arm",
        "tests/envs",
        "reaching/gap_by_hand miscalibrate sb3",
        most=SECOND,
    ),
    "situation": room(
        "pickenv/envs/shared",
        "situation given_goals difficulty",
        "tests/envs",
        "reaching/situation_by_hand reaching/situation given reaching/ladder",
        most=SECOND,
    ),
    "harvest zone": room(
        "pickenv/envs/harvesting",
        "harvest_task",
        "tests",
        "envs/harvest_by_hand harvester/one_cup harvester/environments",
        most=SECOND,
    ),
    "orchard": room(
        "pickenv/orchard",
        "camera vision gripper",
        "tests/orchard",
        "gripper camera_by_hand vision_by_hand camera vision bad_input",
    ),
    "harvester": room(
        "pickenv/harvester",
        "optimiser rules pick_point true_machine zones",
        "tests/harvester",
        "plans_by_hand search_by_hand clock_by_hand pick_point true_machine assignment",
    ),
    "policies": room(
        "agents/policies", "scripted adaptive", "tests/agents", "policies_by_hand scripted policies learned"
    ),
    "rollouts": room("agents/evaluation", "rollout reaches", "tests/agents", "policies_by_hand evaluation"),
    "yields": room(
        "pickenv/study",
        "results/outcomes results/quantiles",
        "tests/study",
        "outcomes yields quantiles rows report",
    ),
    "networks": room(
        "calibration/residuals",
        "bpnn gaussian_process residual_models",
        "tests/calibration/residuals",
        "residual_referees bpnn residual_models",
    ),
    "processes": room(
        "calibration/residuals",
        "gaussian_process",
        "tests/calibration/residuals",
        "residual_referees gaussian_process",
    ),
    "gate": room("calibration/residuals", "gate", "tests/calibration/residuals", "gate_figures gate"),
    "assessment": room(
        "calibration/assessment",
        "quality expected_errors instrument screen metrics",
        "tests/calibration/assessment",
        "thresholds metrics quality verdict expected_errors",
    ),
    "camera": room(
        "calibration",
        "model/pixels camera/boards",
        "tests/calibration",
        "model/pixels camera/lenses camera/boards camera/pictures",
    ),
    "kalman": room(
        "calibration/identification",
        "extended_kalman_filter",
        "tests/calibration/identification",
        "filter_steps kalman",
    ),
    "planning": room("calibration/planning", "plan", "tests/calibration/planning", "plan_figures planning"),
    "pipeline": room(
        "calibration/pipeline",
        "apply calibration result fitting stages",
        "tests/calibration/pipeline",
        "command_figures apply verification stage_choices stages calibration_file",
    ),
    "delivery": room(
        "calibration/delivery",
        "corrected_chain joint_offsets onto_files",
        "tests/calibration/delivery",
        "joint_offsets tables_and_transforms same_chain onto_mjcf kinematics_yaml onto_urdf",
        most=SECOND,
    ),
    "stations": room(
        "calibration",
        "model/measurements identification/robust pipeline/verification pipeline/given",
        "tests/calibration",
        "pipeline/given_rows pipeline/restation_figures reading/kinds_of_files model/pixels pipeline/verification "
        "model/stacked pipeline/instruments",
        most=SECOND,
    ),
    "kinds": room(
        "calibration/model",
        "kinds",
        "tests/calibration",
        "reading/kinds_of_files model/observations model/kinds pipeline/instruments",
        most=SECOND,
    ),
    "harmonics": room(
        "calibration",
        "identification/term_choice model/arm_model",
        "tests/calibration",
        "model/terms_by_hand model/terms identification/mimic identification/harmonics pipeline/stage_choices "
        "pipeline/blocks",
        most=SECOND,
    ),
    "uncertainty": room(
        "calibration",
        "pipeline/calibration identification/robust identification/diagnosis",
        "tests/calibration",
        "pipeline/command_figures identification/robust pipeline/within95 identification/diagnosis",
        most=SECOND,
    ),
    "inverse": room(
        "pickenv/arm/kinematics",
        "inverse task_space workspace",
        "tests/arm/kinematics",
        "inverse_steps inverse workspace",
    ),
    "arm files": room(
        "pickenv/arm/files",
        "urdf joint_chain flange mjcf load xml_values arm_file joint_keys",
        "tests/arm",
        "files/urdf files/mjcf files/flange files/ur_yaml kinematics/mimic files/arm_file plant/plant_file",
    ),
    "study": room(
        "pickenv/study/running", "batched batched_identification arm_by_arm", "tests/study", "batched executors"
    ),
    "analysis": room(
        "pickenv/study/analysis", "sensitivity sobol single_arms study_report", "tests/study", "sensitivity report"
    ),
    "campaign": room(
        "pickenv/arm",
        "plant/campaign effects/hysteresis effects/residual_field effects/drives",
        "tests/arm",
        "effects/guides effects/own_waves plant/campaign plant/plant",
        most=SECOND,
    ),
    "sight": room(
        "pickenv/orchard",
        "circles sight sight_errors",
        "tests/orchard",
        "circle_steps circle_matches circles sight_tables sight",
        most=SECOND,
    ),
    "conditions": room("agents/evaluation", "conditions_study", "tests/agents/evaluation", "conditions", most=SECOND),
    "blocked gain": room("agents/evaluation", "blocked_gain", "tests", "bench/gains_page demo_table", most=SECOND),
    "bench": room(
        "pickenv/bench",
        "bench_tables gains run_bench spread_rows peers real_sets",
        "tests/bench",
        "bench_parts bench_tables gains spread_rows gains_page bench_command",
        most=SECOND,
    ),
    "compare": room(
        ".",
        "agents/evaluation/compare agents/evaluation/compared_policies agents/evaluation/contenders "
        "pickenv/inspect/runs/comparison_summary pickenv/inspect/runs/matters",
        "tests",
        "agents/compare_by_hand inspect/runs/matters agents/evaluation/compare_numbers agents/compare "
        "inspect/runs/summary_numbers",
        most=SECOND,
    ),
    "leaderboard": room(
        "pickenv/experiments",
        "methods policies policy_tables",
        "tests/experiments",
        "leaderboard policies",
        most=SECOND,
    ),
    "pictures": room(
        "pickenv/pictures",
        "solids stage",
        "tests/pictures",
        "solids drawers",
        most=SECOND,
    ),
    "films": room(
        "pickenv/inspect/films",
        "film_plan film_stage make_film",
        "tests/inspect/films",
        "film_words film_by_hand film",
        most=SECOND,
    ),
    "recordings": room(
        "pickenv/inspect",
        "runs/harvest_trace runs/calibration_trace runs/matters recordings/details recordings/comparison_recording "
        "recordings/harvest_recording",
        "tests/inspect",
        "runs/traces harvest_recording recorded_columns details runs/summary_numbers recording",
        most=SECOND,
    ),
    "figures": room(
        "pickenv/inspect/figures",
        "field_figure plot_harvest plot_pixels plot_policies plot_conditions plot_errors",
        "tests/inspect/figures",
        "misalignments whole_panels figure_titles figure_numbers pixel_errors",
        most=SECOND,
    ),
    "reports": room(
        "pickenv/inspect",
        "runs/comparison_summary figures/plot_errors figures/plot_calibration reports/demo_report "
        "reports/calibration_report reports/report_words",
        "tests/inspect",
        "figures/whole_figures report_cells runs/summary_numbers figures/figure_numbers figures/page_numbers "
        "calibration_report report",
    ),
}
