"""The cases in which a calibration must never be worse than the drawing, each by the default command.

A case fits what a user would fit and judges it where the truth is known. Its rows say where, in one unit.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from never_worse.judge import (
    VECTORS,
    PoseOf,
    aligned_errors,
    calibrated_flange,
    chain_of_origins,
    covered,
    flange_of,
    regions,
    rms,
)
from scipy.optimize import least_squares as solve
from scipy.spatial.transform import Rotation

import pickenv
from pickenv.arm import (
    Arm,
    Array,
    Geometry,
    Plant,
    Pose,
    forward,
    from_standard_dh,
    identity_pose,
    load_arm,
    load_plant,
    plant_at,
    rotation_matrix,
)
from pickenv.arm.kinematics.forward import pose_of
from pickenv.arm.kinematics.geometry import behind, inverse_pose
from pickenv.arm.plant.campaign import Pace, moved, switched_on
from pickenv.arm.plant.plant_file import draw_arms
from pickenv.base import Ends, InputError, statistic_interval, write_text
from pickenv.calibration import (
    Choices,
    Measurements,
    Result,
    align,
    complete_model,
    frames_model,
    random_joints,
    read_observations,
    simulated_tracker,
)
from pickenv.calibration.camera.boards import Board
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.pixels import Lens, PixelObservations, projected
from pickenv.experiments.robots import SETS

MM = 1e3


def mm_left(errors: Array) -> float:
    """RMS of positions in errors ``(N, 3 or 6)``, mm."""
    return MM * rms(errors[:, :3])


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        subject: What was fitted.
        where: Where, or on what, it is judged.
        calibrated: Figure of the calibrated arm by the default command, in `unit`.
        nominal: The same of the nominal arm; None where there is none.
        plain: The same of plain least squares; None where it was not asked.
        unit: Of the three.
        within95: Share of the true errors that are within what was stated for 95 of 100; None where not asked.
        grade: The verdict.
        calibrated_ci95: 95 % interval of `calibrated` over the joint vectors that judge; None where not asked.
        nominal_ci95: The same of `nominal`.
        at_most: What `calibrated` must not exceed; None where the row is for information.
        share: Least and most that `within95` may be; None where it is for information.
    """

    subject: str
    where: str
    calibrated: float
    nominal: float | None = None
    plain: float | None = None
    unit: str = "mm"
    within95: float | None = None
    grade: str | None = None
    calibrated_ci95: Ends | None = None
    nominal_ci95: Ends | None = None
    at_most: float | None = None
    share: tuple[float, float] | None = None

    @property
    def meets(self) -> bool | None:
        """Whether the row is what it may be; None where nothing is asked."""
        asked = [] if self.at_most is None else [self.calibrated <= self.at_most]
        if self.share is not None:
            asked.append(self.within95 is not None and self.share[0] <= self.within95 <= self.share[1])
        return all(asked) if asked else None

    @property
    def worse(self) -> bool:
        """Whether the calibrated arm is worse than the drawing."""
        return self.nominal is not None and self.calibrated > self.nominal


@dataclass(frozen=True)
class Settings:
    """What the cases are run with.

    Attributes:
        data: Folder of the measured data sets.
        folder: Where generated sequences and files are kept.
        seed: Seeds everything that is drawn.
        sequences: KinHEC sequences of each arm.
        arms: Printed SO-101 that are drawn.
        step: Called with what was done, after each fit.
    """

    data: Path
    folder: Path
    seed: int = 0
    sequences: int = 8
    arms: int = 30
    step: Callable[[str], None] = print


def grade_of(result: Result | None) -> str:
    """The verdict's word; of a refusal too."""
    return "refused" if result is None else str(result.quality.grade)


def delivered(arm: Arm, rows: Any, **options: Any) -> Result | None:
    """A calibration; None if it is refused, and the arm stays as it was drawn."""
    try:
        return pickenv.calibrate(arm, rows, **options)
    except InputError:
        return None


def judged(
    subject: str, result: Result | None, nominal: Geometry, truth: PoseOf, where: dict[str, Array]
) -> Iterator[Row]:
    """Rows of one calibration against the true arm, region by region."""
    drawing = flange_of(nominal)
    flange = drawing if result is None else calibrated_flange(result.calibration)
    for name, joints in where.items():
        errors = [MM * aligned_errors(model, truth, joints) for model in (flange, drawing)]
        ends = dict(zip(("calibrated_ci95", "nominal_ci95"), (statistic_interval(e, rms) for e in errors), strict=True))
        share = None if result is None else covered(result.calibration, truth, joints)
        yield Row(subject, name, *map(rms, errors), within95=share, grade=grade_of(result), **ends)


UR10E_LIMITS = {"at the poses": 0.85, "0.15 rad beside": 1.0, "box of ranges": 1.3, "all joints": 1.6}


def ur10e(settings: Settings) -> list[Row]:
    """23 pictures of a real UR10e, against its maker's factory calibration, which the judge alone reads."""
    folder, arm = settings.data / "ur10e_realsense", load_arm("ur10e")
    views, columns = folder / "views.csv", folder / "columns.toml"
    truth = chain_of_origins(folder / "factory_kinematics.yaml")
    measured = read_observations([views], arm.nominal, columns).joints
    result = pickenv.calibrate(arm, views, columns=columns)
    settings.step("23 pictures")
    every = np.full(arm.nominal.joints, np.pi)
    where = regions(measured, -every, every, settings.seed)
    rows = judged("UR10e, 23 pictures", result, arm.nominal, truth, where)
    most = {name: 1.0 if len(joints) < VECTORS else 0.98 for name, joints in where.items()}
    return [replace(row, at_most=UR10E_LIMITS[row.where], share=(0.90, most[row.where])) for row in rows]


def kinhec(settings: Settings) -> list[Row]:
    """Camera poses that KinHEC generates of arms with errors in their DH tables, against its own true tables.

    Tier `small`, track `robot_error`, with the seeds of that tier: 30 poses a sequence, stated as 1 mm and 2 mrad.
    """
    rows: list[Row] = []
    for robot, limits in KINHEC_LIMITS.items():
        figures = judged_sequences(settings, "robot_error", robot, with_wrong_table)
        rows += [row for pair in figures for row in pair]
        for part, limit in zip(zip(*figures, strict=True), limits, strict=True):
            rows.append(replace(mean_row(f"{robot}, mean of {len(figures)}", part, limit), grade=None))
        verdicts = [(pair[0].grade, any(row.worse for row in pair)) for pair in figures]
        false = verdicts.count(("good", True))
        refused = sum(verdicts.count((grade, False)) for grade in REFUSALS)
        many = REFUSED_IN_8 * len(figures) / 8
        rows.append(Row(robot, "GOOD, and worse than nominal", false, unit="arms", at_most=0.0))
        rows.append(Row(robot, "better than nominal, and refused", refused, unit="arms", at_most=many))
    return rows


def kinhec_noise(settings: Settings) -> list[Row]:
    """KinHEC's tracks of noise and of outliers, whose arms are as drawn: at most what plain least squares leaves."""
    rows: list[Row] = []
    for track, robot in (("noise", "ur5e"), ("noise", "iiwa14"), ("outliers", "ur5e")):
        figures = judged_sequences(settings, track, robot, at_stations)
        for part in zip(*figures, strict=True):
            row = mean_row(f"{robot}, {track}, mean of {len(figures)}", part, None)
            rows.append(replace(row, at_most=row.plain))
    return rows


KINHEC_LIMITS = {"ur5e": (0.76, 1.8), "iiwa7": (None, None)}
"""What the mean of the sequences may be, 0.15 rad beside the poses and over all joints, mm."""

REFUSED_IN_8 = 1.0
"""So many truly better arms of eight may be refused."""

REFUSALS = ("do not use", "refused")


def with_wrong_table(plan: Any) -> bool:
    """Whether a sequence is of an arm whose DH table is off."""
    return "dh_error" in plan.robot_noise["models"]


def at_stations(plan: Any) -> bool:
    """Whether a sequence is of poses at which the arm stood still, with the camera on its hand."""
    return bool(plan.sampling["mode"] == "stations" and plan.configuration == "eye_in_hand")


def judged_sequences(settings: Settings, track: str, robot: str, wanted: Callable[[Any], bool]) -> list[list[Row]]:
    """The first sequences of an arm in a track of KinHEC, each beside its poses and over all joints.

    Where the tier has too few, it is asked for more repeats.
    """
    try:
        from kinhec import generate_sequence  # type: ignore[import-untyped, unused-ignore]
        from kinhec.plans import build_plan, load_tier  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise InputError("the package kinhec is missing; pip install kinhec") from None
    tier, chosen, figures = load_tier("small"), [], []
    for repeats in (tier["tracks"][track]["repeats"], settings.sequences):
        tier["tracks"][track]["repeats"] = repeats
        chosen = [plan for plan in build_plan(tier, [track])[track] if plan.robot == robot and wanted(plan)]
        if len(chosen) >= settings.sequences:
            break
    for number, plan in enumerate(chosen[: settings.sequences], start=1):
        figures.append(judged_sequence(generate_sequence(plan), settings.seed))
        settings.step(f"{track}, {robot}, sequence {number}")
    return figures


def dh_geometry(robot: Any, **numbers: Any) -> Geometry:
    """The geometry of an arm of KinHEC, with numbers of its DH table replaced."""
    table = {name: numbers.get(name, getattr(robot, name)) for name in ("a", "d", "alpha", "theta_offset")}
    names, ends = tuple(f"J{i + 1}" for i in range(robot.dof)), {"lower": robot.q_min, "upper": robot.q_max}
    return from_standard_dh(names, (False,) * robot.dof, theta=table.pop("theta_offset"), **table, **ends)


def judged_sequence(sequence: Any, seed: int) -> list[Row]:
    """One sequence: where the camera stood on the board, at the joints that the robot read."""
    from kinhec.robots import get_robot  # type: ignore[import-untyped, unused-ignore]

    robot, config = get_robot(sequence.config.robot), sequence.config
    nominal, true = dh_geometry(robot), dh_geometry(robot, **sequence.extra.get("true_dh", {}))
    columns = sequence.camera_table.to_pydict()
    board, turn = (
        np.array([columns[f"cam_target_meas_{name}"] for name in names]).T
        for names in (("px", "py", "pz"), ("qx", "qy", "qz", "qw"))
    )
    back = Rotation.from_quat(turn).inv()
    joints = np.array(sequence.robot_table.to_pydict()["q_meas"])
    std = (float(np.median(config.camera_noise[name])) for name in ("trans_std_m", "rot_std_rad"))
    seen = joints, -back.apply(board), back.as_matrix(), nominal.prismatic, *std
    rows = Measurements(*seen, source=config.sequence_id, std_stated=True)
    arm = Arm(robot.name, robot.source, nominal, None, np.asarray(robot.qd_max, dtype=float))
    where = regions(rows.joints, nominal.lower, nominal.upper, seed)
    near = {name: where[name] for name in ("0.15 rad beside", "all joints")}
    aligned = align(nominal, rows, frames_model(nominal), judge=False).geometry
    plain = flange_of(least_squares(aligned, rows))
    noise = config.robot_noise
    subject, truth = f"{robot.name}, {config.sequence_id[-2:]}", flange_of(true)
    if with_wrong_table(config):
        subject += f": {noise['dh_len_std_m'] * MM:g} mm, {np.degrees(noise['dh_ang_std_rad']):.2g} deg"
    return [
        replace(row, plain=MM * rms(aligned_errors(plain, truth, near[row.where])))
        for row in judged(subject, delivered(arm, rows), nominal, truth, near)
    ]


def mean_row(subject: str, rows: Sequence[Row], at_most: float | None) -> Row:
    """The mean over sequences or draws, with their verdicts; without a bound it may be what nominal leaves."""
    mean: dict[str, Any] = {}
    for name in ("calibrated", "nominal", "plain", "within95"):
        values = [value for row in rows if (value := getattr(row, name)) is not None]
        mean[name] = float(np.mean(values)) if values else None
    mean["grade"] = counts_of([str(row.grade) for row in rows])
    return Row(subject, rows[0].where, **mean, at_most=mean["nominal"] if at_most is None else at_most)


URDF_POSES, URDF_NOISE = 80, (2e-4, 1e-3)
URDF_OFF = (1e-3, 4e-3)
"""Standard deviation of each of the six numbers of an origin, m and rad."""

URDF_LIMIT = 0.45
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0")
ORIGINS = ("0 0 0.3", "0.1 0 0.2", "0 0.05 0.6", "0.5 0 0.1", "0.3 0 0")
FLANGE = "0.12 0.02 0.05"


def urdf_text(move: Callable[[], tuple[Array, Array]]) -> str:
    """A URDF of five joints; ``move`` gives what is added to each origin, the flange's too: m and rad."""
    parts, links = ['<robot name="five">', '<link name="base"/>'], ("base", "l1", "l2", "l3", "l4", "l5", "flange")
    for i, place in enumerate((*ORIGINS, FLANGE)):
        shift, turn = move()
        xyz = " ".join(f"{value:.17g}" for value in np.array(place.split(), dtype=float) + shift)
        rpy = " ".join(f"{value:.17g}" for value in turn)
        kind, axis = "fixed", ""
        if i < len(AXES):
            kind, axis = "revolute", f'<axis xyz="{AXES[i]}"/><limit lower="-2" upper="2" effort="1" velocity="1"/>'
        parent, child = links[i : i + 2]
        parts.append(f'<link name="{child}"/><joint name="j{i + 1}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>')
        parts.append(f'<parent link="{parent}"/><child link="{child}"/>{axis}</joint>')
    return "\n".join([*parts, "</robot>", ""])


def urdf_origins(settings: Settings) -> list[Row]:
    """An arm of five joints whose every joint origin is off, base and flange too, by poses in its own base frame."""
    rng = np.random.default_rng(settings.seed)
    settings.folder.mkdir(parents=True, exist_ok=True)
    files = {name: settings.folder / f"five_{name}.urdf" for name in ("nominal", "true", "patched")}
    write_text(files["nominal"], urdf_text(lambda: (np.zeros(3), np.zeros(3))))
    write_text(files["true"], urdf_text(lambda: (rng.normal(0.0, URDF_OFF[0], 3), rng.normal(0.0, URDF_OFF[1], 3))))
    arm, true = (load_arm(files[name]) for name in ("nominal", "true"))

    def measured(count: int) -> Measurements:
        joints = random_joints(arm.nominal, count, rng)
        pose = forward(true.nominal, joints)
        turn = Rotation.from_rotvec(rng.normal(0.0, URDF_NOISE[1], (count, 3))).as_matrix()
        seen = pose.position + rng.normal(0.0, URDF_NOISE[0], (count, 3))
        return Measurements(
            joints, seen, turn @ pose.rotation, arm.nominal.prismatic, *URDF_NOISE, frames="known", std_stated=True
        )

    rows, test = measured(URDF_POSES), measured(VECTORS)
    result = pickenv.calibrate(arm, rows)
    settings.step("80 poses")
    files["patched"].unlink(missing_ok=True)
    result.export(files["patched"], onto=files["nominal"])
    patched = load_arm(files["patched"]).nominal
    errors = {
        "held out, with its noise": mm_left(result.calibration.errors(test)),
        "behind the patched URDF": mm_left(test.difference(patched)),
    }
    common = {"nominal": mm_left(test.difference(arm.nominal)), "grade": grade_of(result), "at_most": URDF_LIMIT}
    return [Row("URDF, 5 joints, all origins off", where, error, **common) for where, error in errors.items()]


FEW, DRAWS = (5, 10, 20, 50, 200), 5


def few_rows(settings: Settings) -> list[Row]:
    """Few random tracker rows of the UR5's grid, judged on all the others; a refusal leaves the drawing as it is."""
    arm, grid, _ = SETS["ur5"].load(settings.data)
    assert isinstance(grid, Measurements)
    rng, rows = np.random.default_rng(settings.seed), []
    for count in FEW:
        drawn = []
        for draw in range(DRAWS):
            order = rng.permutation(len(grid))
            drawn.append(judged_rows(arm, grid.select(order[:count]), grid.select(order[count:])))
            settings.step(f"{count} rows, draw {draw + 1}")
        mean = mean_row(f"UR5, {count} rows, mean of {DRAWS}", drawn, None)
        rows.append(replace(mean, at_most=min(mean.nominal, mean.plain / 2) if count == 10 else mean.nominal))
        worst = max(row.calibrated / row.nominal for row in drawn)
        rows.append(Row(mean.subject, "worst draw, part of nominal", worst, unit="", at_most=1.0))
    return rows


def judged_rows(arm: Arm, rows: Measurements, rest: Measurements) -> Row:
    """Errors on other rows: of the nominal arm with base and tool from these rows, least squares, and calibrated."""
    aligned = align(arm.nominal, rows, frames_model(arm.nominal), judge=False).geometry
    nominal, plain = (mm_left(rest.difference(fitted)) for fitted in (aligned, least_squares(aligned, rows)))
    result = delivered(arm, rows)
    calibrated = nominal if result is None else mm_left(result.calibration.errors(rest))
    return Row("", "rest of the grid", calibrated, nominal, plain, grade=grade_of(result))


def least_squares(start: Geometry, rows: Measurements) -> Geometry:
    """SciPy's least squares for all parameters at once, without priors and without a choice among them."""
    model, none = complete_model(start), np.zeros(0)

    def moved_by(steps: Array) -> ArmModel:
        change = np.zeros(len(start.parameter_names))
        change[model.columns] = steps * model.tolerance
        return ArmModel(start.displaced(change))

    def slopes(steps: Array) -> Array:
        return np.asarray(-rows.jacobian(moved_by(steps), none)[0][:, model.columns] * model.tolerance)

    def misses(steps: Array) -> Array:
        return rows.residual(moved_by(steps), none)

    solved = solve(misses, np.zeros(len(model.columns)), slopes)
    return moved_by(solved.x).geometry


WIDE, CLUSTERS = 40, (0, 300, 1100)
CLUSTER = 0.2
"""Standard deviation of a joint in a cluster, rad or m, and at most a twentieth of the joint's range."""

CLUSTERED_PLANTS = ("field", "coarse:ur5e")
"""Simulated arms with effects that no model holds."""

CLUSTER_DRAWS = 3


def clustered(settings: Settings) -> list[Row]:
    """Wide tracker rows and many clustered ones of simulated arms with unmodelled errors, judged on wide rows."""
    rows: list[Row] = []
    for name in CLUSTERED_PLANTS:
        draws = [list(clustered_draw(name, settings.seed + draw, settings)) for draw in range(CLUSTER_DRAWS)]
        alone = [draw[0].calibrated for draw in draws]
        for count, some in zip(CLUSTERS, zip(*draws, strict=True), strict=True):
            subject = f"{name}, {WIDE} wide rows" + (f" + {count} clustered" if count else "")
            rows.append(mean_row(subject, some, float(np.mean(alone)) if count else None))
            if count:
                worst = max(row.calibrated / first for row, first in zip(some, alone, strict=True))
                rows.append(Row(subject, "worst draw, part of the 40 alone", worst, unit="", at_most=1.0))
    return rows


def clustered_draw(name: str, seed: int, settings: Settings) -> Iterator[Row]:
    """Errors on wide rows, without clustered rows and with more and more of them."""
    plant, rng = load_plant(name), np.random.default_rng(seed)
    arm, nominal = plant.arm, plant.arm.nominal
    wide, middle = random_joints(nominal, WIDE, rng), random_joints(nominal, 1, rng)[0]
    width = np.minimum(CLUSTER, (nominal.upper - nominal.lower) / 20)
    near = np.clip(middle + width * rng.normal(size=(max(CLUSTERS), nominal.joints)), nominal.lower, nominal.upper)
    test = simulated_tracker(plant, random_joints(nominal, VECTORS, rng), rng)
    for count in CLUSTERS:
        data = simulated_tracker(plant, np.concatenate([wide, near[:count]]), np.random.default_rng(seed + 1))
        result = pickenv.calibrate(arm, data)
        settings.step(f"{name}, {WIDE} + {count} rows")
        errors = (mm_left(result.calibration.errors(test)), mm_left(test.difference(nominal)))
        yield Row("", "wide rows", *errors, grade=grade_of(result))


def counts_of(grades: list[str]) -> str:
    """Verdicts, counted."""
    return ", ".join(f"{grades.count(grade)} {grade}" for grade in sorted(set(grades)))


BOARD = Board(kind="charuco", columns=7, rows=5, square=0.025, marker=0.018, dictionary="5x5_100")
WEBCAM = Lens(np.array([620.0, 622.0, 323.0, 238.0, -0.08, 0.05, 0.0008, -0.0005, 0.01]), (640, 480))
PIXEL_STD = 0.3
VIEWS = 25
FROM_BELOW = np.radians(5.0)
"""Every joint comes from so far below, as docs/so101.md says, rad."""

SO101_BEFORE = 9.78
"""Mean of 30 arms with seed 0 by least squares without priors, mm; at most half of it is asked for."""


def so101(settings: Settings) -> list[Row]:
    """Printed SO-101 with free play and friction, a webcam on the gripper, 25 views; judged over all joints."""
    rng = np.random.default_rng(settings.seed)
    arms = draw_arms("printed:so101", "printed", settings.arms, rng, without=["joint_compliance"])
    rows, where = [], {"all joints": random_joints(load_arm("so101").nominal, VECTORS, rng)}
    for fit in ("auto", "offsets"):
        arms_judged: list[Row] = []
        for i in range(settings.arms):
            plant = plant_at(arms, i)
            bare = replace(plant, geometry=replace(plant.geometry, base=identity_pose(), tool=identity_pose()))
            truth = aligned_to(reached(bare, where["all joints"]))
            views = webcam_views(plant, np.random.default_rng([settings.seed, i]))
            result = delivered(plant.arm, views, choices=Choices(fit=fit))
            arms_judged += judged("", result, plant.arm.nominal, truth, where)
            settings.step(f"fit {fit}, arm {i + 1}")
        subject = f"SO-101, {settings.arms} arms, fit {fit}"
        calibrated, nominal = np.mean([(row.calibrated, row.nominal) for row in arms_judged], axis=0)
        grades = counts_of([str(row.grade) for row in arms_judged])
        rows.append(Row(subject, "all joints", calibrated, nominal, grade=grades, at_most=SO101_BEFORE / 2))
        rows.append(Row(subject, "worse than nominal", sum(row.worse for row in arms_judged), unit="arms", at_most=0.0))
    return rows


def aligned_to(pose: Pose) -> PoseOf:
    """The true flange at the joints that it was computed for."""
    return lambda _joints: pose


def reached(plant: Plant, joints: Array) -> Pose:
    """Where the tool stands at joint commands, each come to from below."""
    before = joints - FROM_BELOW
    state = switched_on(plant, np, before, 0.0)
    return pose_of(moved(plant, np, state, before, joints, Pace(period=0.1, dwell=1.0))[1])


def webcam_views(plant: Plant, rng: np.random.Generator) -> PixelObservations:
    """Views of a board on the table by a webcam beside the gripper, each showing at least half of the board."""
    tip = plant.arm.nominal.tool.position
    z = tip / np.linalg.norm(tip)
    x = np.array([0.0, 1.0, 0.0]) - z[1] * z
    x /= np.linalg.norm(x)
    look = np.stack([x, np.cross(z, x), z], axis=1)
    camera = Pose(0.3 * tip + 0.05 * look[:, 1], look @ rotation_matrix([0.35, 0.1, 0.05]))
    board = Pose(np.array([0.20, 0.06, 0.01]), np.diag([1.0, -1.0, -1.0]))
    eye = replace(plant, geometry=replace(plant.geometry, tool=camera))
    joints = random_joints(plant.geometry, 20_000, rng)
    blank = np.zeros((len(joints), len(BOARD.corners), 2))
    std = np.full(blank.shape[:2], PIXEL_STD)
    views = PixelObservations(joints, blank, std > 0.0, BOARD.corners, WEBCAM, np.zeros(9), std)
    drawn = ArmModel(replace(plant.geometry, base=behind(inverse_pose(board), plant.geometry.base), tool=camera))
    seen = views.visible(drawn, np.zeros(0), margin=5.0)
    near = views.in_camera(drawn)[..., 2]
    seen &= (near > 0.07) & (near < 0.4)
    rows = np.flatnonzero(seen.mean(axis=1) > 0.5)[:VIEWS]
    pose = reached(eye, joints[rows])
    corners = BOARD.corners @ board.rotation.T + board.position
    inside = (corners - pose.position[:, None]) @ pose.rotation
    pixels = projected(WEBCAM.values, inside) + PIXEL_STD * rng.normal(size=inside[..., :2].shape)
    return replace(views.select(rows), corners=pixels, seen=seen[rows], source="webcam")


MANY_ROWS = 10_786
MOST_SECONDS = {"wall": 5.0, "processor": 60.0}


def speed(settings: Settings) -> list[Row]:
    """How long two calibrations take: many rows by the clock, and blocks with everything automatic by the processor."""
    arm, series, _ = SETS["ur10_a"].load(settings.data)
    many = series.select(np.arange(MANY_ROWS))
    grade, wall, busy = timed_calibration(arm, many)
    settings.step(f"{MANY_ROWS} rows")
    arm, grid, _ = SETS["ur5"].load(settings.data)
    few = grid.select(np.sort(np.random.default_rng(settings.seed).permutation(len(grid.joints))[:450]))
    blocked, _, processor = timed_calibration(arm, few, split="blocked")
    settings.step("450 rows, blocked")
    subject, most = f"UR10 A, {MANY_ROWS} rows", MOST_SECONDS["processor"]
    return [
        Row(subject, "by the clock", wall, unit="s", grade=grade, at_most=MOST_SECONDS["wall"]),
        Row(subject, "processor", busy, unit="s", grade=grade),
        Row("UR5, 450 rows, blocked", "processor", processor, unit="s", grade=blocked, at_most=most),
    ]


def timed_calibration(arm: Arm, rows: Any, **options: Any) -> tuple[str, float, float]:
    """The verdict of a calibration, and its seconds by the clock and of the processor."""
    begin, spent = time.perf_counter(), sum(os.times()[:4])
    grade = grade_of(pickenv.calibrate(arm, rows, **options))
    return grade, time.perf_counter() - begin, sum(os.times()[:4]) - spent


CASES: dict[str, Callable[[Settings], list[Row]]] = {
    case.__name__: case for case in (ur10e, kinhec, kinhec_noise, urdf_origins, few_rows, clustered, so101, speed)
}
