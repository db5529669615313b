"""Tolerance studies: their settings, read from a TOML file, and the arms that they draw, calibrate and judge.

A study is a list of settings. A setting is a population of arms, the way to calibrate them, and the payload that they
carry. Files and columns are in mm, deg and kg, as their names say; the code computes in SI units.

All random numbers depend on the study's seed and the arm's number alone, not on chunks, workers or settings. In every
setting, arm 17 deviates in the same directions, reaches for the same fruit and is measured at the same poses. Different
arms have different fruit, poses and noise. They are therefore independent samples of the design and its workspace.

Arms are computed one by one, with arrays of the same shapes and in one thread. The results are thus the same to the bit
for any number of workers and any size of chunks. Errors are m and rad; the columns of rows are mm and deg.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, astuple, dataclass, replace
from functools import cache
from itertools import groupby, product
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from scipy.stats import qmc

from pickenv.arm import (
    Array,
    Geometry,
    Instrument,
    Plant,
    Tolerances,
    draw_plants,
    forward,
    load_instrument,
    load_plant,
    load_tolerances,
    plant_at,
    pose_error,
)
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.arm.files.arm import content_sha256
from pickenv.arm.plant.campaign import TRACKER, NormalDraws, normal_draws
from pickenv.arm.plant.populations import GRADE
from pickenv.base import LIMITS, ONCE, SHARE, WHOLE, Check, InputError, Key, Unit, single_threaded, toml_of, toml_table
from pickenv.base.registry import names
from pickenv.base.toml_tables import made
from pickenv.calibration import Calibration, Compensator, Measurements, identify, random_joints, simulated_tracker
from pickenv.calibration.identification.least_squares import identify_converged
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel, link_model
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD, tracked
from pickenv.calibration.residuals.residual_models import fit_residual
from pickenv.envs.shared.task import GOAL_MARGIN
from pickenv.experiments.engine import Rows, joined

VERSION = 3
"""Version of the rows. It is raised when the same configuration would give other rows than before. Old and new rows
thus never mix."""

RAW, LS = "raw", "ls"
METHODS = (RAW, LS, *(f"{LS}+{kind}" for kind in names("residual")))
"""Ways of calibration: none, least squares, and least squares with each registered residual model."""


@toml_table
class Noise:
    """Standard deviations of the tracker's readings, per axis.

    Attributes:
        position_mm: Standard deviation of a position, mm.
        attitude_deg: Standard deviation of an attitude, deg.
    """

    position_mm: Annotated[float, Unit("mm").within(*LIMITS["position_mm"]), Key("position_mm")]
    attitude_deg: Annotated[float, Unit("deg").within(*LIMITS["attitude_deg"]), Key("attitude_deg")]


DEFAULT_NOISE = Noise(POSITION_STD * 1e3, math.degrees(ATTITUDE_STD))
"""Noise of the tracker in a study whose file gives no noise."""


SETTING = ("setting", "tolerances", "it_grade", "poses", "noise_mm", "noise_deg", "payload_kg", "method")
"""Columns that identify a setting."""


@dataclass(frozen=True)
class Setting:
    """One setting of a study: a population of arms, how they are calibrated, and the payload that they carry.

    Attributes:
        number: Position in the study's list, from 0.
        tolerances: Tolerance class.
        it_grade: ISO 286-1 grade of the lengths.
        poses: Number of calibration poses; 0 without calibration.
        noise_mm: Standard deviation of the tracker's positions, mm; 0 without calibration.
        noise_deg: Standard deviation of the tracker's attitudes, deg; 0 without calibration.
        payload_kg: Mass held at the tool while picking, kg; during calibration it is the plant's own payload.
        method: Method of calibration: "raw" (none), "ls", or "ls+" and a residual model, as in `METHODS`.
    """

    number: int
    tolerances: str
    it_grade: int
    poses: int
    noise_mm: float
    noise_deg: float
    payload_kg: float
    method: str

    def columns(self) -> dict[str, Any]:
        """Return the columns that identify this setting in the rows of a study, as a dictionary from name to value."""
        return dict(zip(SETTING, astuple(self), strict=True))

    @property
    def calibration(self) -> Setting:
        """This setting with ``number`` and ``payload_kg`` set to 0, since neither changes an arm's calibration."""
        return replace(self, number=0, payload_kg=0.0)


POSES = WHOLE.within(*LIMITS["poses"])
METHOD = Check(METHODS.__contains__, f"one of {', '.join(METHODS)}")
TRACKERS = Check(lambda value: isinstance(value, list), "a list of tables with position_mm and attitude_deg")
PLANT = Check(lambda value: isinstance(value, str), "the name of a plant preset or a path to a plant file (.toml)")
INSTRUMENT = Check(lambda value: isinstance(value, str), "the name of a shipped instrument or a path to a file (.toml)")
IN_PICKING, IN_CALIBRATION = Key(section="picking"), Key(section="calibration")
PAYLOAD, RADIUS = Unit("kg").within(*LIMITS["payload_kg"]), Unit("mm").within(*LIMITS["radius_mm"]).positive


@toml_table
class StudyConfig:
    """Configuration of a tolerance study; `load_study` reads it.

    Attributes:
        plant: Plant preset, or path to a plant file.
        seed: Seed of arms, noise, fruit and poses.
        arms: Number of arms N in every setting.
        chunk: Number of arms that are computed and stored together.
        fruit: Number of fruit M that every arm reaches for.
        payload_kg: Masses held at the tool while picking, kg.
        radius_mm: A fruit counts as reached if the tool ends within this distance of the fruit, mm.
        share: An arm is within specification if it reaches at least this share of its fruit, from 0 to 1.
        tolerances: Tolerance classes, by name or path.
        it_grades: ISO 286-1 grades of the lengths, in place of the grade of each class; None keeps the class's grade.
        methods: Methods of calibration, each "raw" (none), "ls", or "ls+" and a residual model, as in `METHODS`.
        poses: Numbers of calibration poses that are compared.
        noise: Standard deviations of the readings, one for each case that is compared, in place of the instrument's
            own. The deviations include errors of range and of centring.
        instrument: Instrument that measures the arms: a name of `pickenv.arm.load_instrument`, or a path. All its
            properties except the noise are used, such as the waiting time before each reading.
        residual_poses: Number of further poses for a learnt residual.
    """

    _: KW_ONLY
    plant: Annotated[str, PLANT]
    seed: Annotated[int, WHOLE.within(*LIMITS["seed"])] = 0
    arms: Annotated[int, WHOLE.within(*LIMITS["arms"])]
    chunk: Annotated[int, WHOLE.within(*LIMITS["chunk"])] = 250
    fruit: Annotated[int, WHOLE.within(*LIMITS["fruit"]), IN_PICKING] = 100
    payload_kg: Annotated[tuple[float, ...], PAYLOAD, ONCE, Key("payload_kg", "picking")] = (0.0,)
    radius_mm: Annotated[float, RADIUS, Key("radius_mm", "specification")]
    share: Annotated[float, SHARE.positive, Key(section="specification")]
    tolerances: Annotated[tuple[str, ...], ONCE, Key("classes", "tolerances")]
    it_grades: Annotated[tuple[int, ...], GRADE, ONCE, Key(section="tolerances")] | None = None
    methods: Annotated[tuple[Annotated[str, METHOD], ...], ONCE, IN_CALIBRATION] = (LS,)
    poses: Annotated[tuple[int, ...], POSES, ONCE, IN_CALIBRATION] = (30,)
    noise: Annotated[tuple[Noise, ...], TRACKERS, ONCE, IN_CALIBRATION] = (DEFAULT_NOISE,)
    residual_poses: Annotated[int, POSES, IN_CALIBRATION] = 100
    instrument: Annotated[str, INSTRUMENT, IN_CALIBRATION] = TRACKER

    def settings(self) -> tuple[Setting, ...]:
        """Return all settings in the order of their numbers: populations vary slowest, payloads fastest.

        Calibrations (method, poses, noise) vary in between. The method "raw", which does not calibrate, has a single
        setting per population and payload: with 0 poses and no noise.
        """
        classes = self.load_tolerances().items()
        populations = [
            (name, grade) for name, tolerances in classes for grade in (self.it_grades or (tolerances.it_grade,))
        ]
        calibrations = [
            (method, poses, noise)
            for method in self.methods
            for poses, noise in ([(0, Noise(0.0, 0.0))] if method == RAW else product(self.poses, self.noise))
        ]
        cells = product(populations, calibrations, self.payload_kg)
        return tuple(
            Setting(number, name, grade, poses, noise.position_mm, noise.attitude_deg, payload, method)
            for number, ((name, grade), (method, poses, noise), payload) in enumerate(cells)
        )

    def chunks(self) -> range:
        """Return the indices, from 0, of all chunks (arms that are computed and stored together)."""
        return range(-(-self.arms // self.chunk))

    def arms_of(self, chunk: int) -> range:
        """Return the numbers, from 0, of the arms in a chunk, given the chunk's index, from 0."""
        return range(chunk * self.chunk, min((chunk + 1) * self.chunk, self.arms))

    def quick(self) -> StudyConfig:
        """Return a smaller study for trying things out: the same settings with at most 40 arms and 20 fruit."""
        return replace(self, arms=min(self.arms, 40), fruit=min(self.fruit, 20), chunk=min(self.chunk, 20))

    def load_plant(self) -> Plant:
        """Load the plant that arms are drawn from, that is the nominal arm with its effects.

        Raises:
            InputError: If there is no such plant, its file has a refused value, or the plant has no link masses
                although a payload is above 0.
        """
        plant = load_plant(self.plant)
        if plant.load is None and any(self.payload_kg):
            raise InputError(
                f"plant '{plant.name}' has no [load], so a payload changes nothing; leave payload_kg out or at 0"
            )
        return plant

    def load_tolerances(self) -> dict[str, Tolerances]:
        """Load the tolerance classes, by name.

        Raises:
            InputError: If there is no such class, or its file has a refused value.
        """
        return {name: load_tolerances(name) for name in self.tolerances}

    def sha256(self) -> str:
        """Return one hash over all that the rows depend on: configuration, plant, instrument and tolerance classes.

        Raises:
            InputError: If a plant, instrument or tolerance class does not exist, or its file has a refused value.
        """
        parts = self.load_plant(), load_instrument(self.instrument), list(self.load_tolerances().values())
        return content_sha256(VERSION, self, *parts)

    def toml(self) -> str:
        """Return this configuration as the text of a TOML file that `load_study` reads."""
        noise = ", ".join(
            f"{{ position_mm = {n.position_mm!r}, attitude_deg = {n.attitude_deg!r} }}" for n in self.noise
        )
        grades = "" if self.it_grades is None else f"it_grades = {list(self.it_grades)}\n"
        return (
            f"plant = {json.dumps(self.plant)}\nseed = {self.seed}\narms = {self.arms}\nchunk = {self.chunk}\n\n"
            f"[picking]\nfruit = {self.fruit}\npayload_kg = {list(self.payload_kg)}\n\n"
            f"[specification]\nradius_mm = {self.radius_mm!r}\nshare = {self.share!r}\n\n"
            f"[tolerances]\nclasses = {json.dumps(self.tolerances)}\n{grades}\n"
            f"[calibration]\nmethods = {json.dumps(self.methods)}\nposes = {list(self.poses)}\nnoise = [{noise}]\n"
            f"residual_poses = {self.residual_poses}\ninstrument = {json.dumps(self.instrument)}\n"
        )


def load_study(path: str | Path) -> StudyConfig:
    """Read a study from a TOML file (`scripts/tolerance_study.toml` shows every key).

    Raises:
        InputError: If the file is missing, or a key is unknown or its value refused; the message names file and key.
    """
    content, text = toml_of(path)
    for key in ("sha256", "arithmetic"):  # in results folders
        content.pop(key, None)
    config = made(StudyConfig, content, str(path), text=text)
    config.load_tolerances()  # what is unknown is refused now, not an hour later
    config.load_plant()
    load_instrument(config.instrument)
    return config


# What is drawn.

ARM_STREAM, TRACKER_STREAM, FRUIT_STREAM, POSES_STREAM, RESIDUAL_STREAM = range(5)
"""First part of the spawn key of each random stream."""

MAX_TILT = math.radians(30.0)
"""Largest angle of the tool with the vertical when it reaches for fruit, rad, as in `pickenv/Reach-v0`."""

DRAWS = 1000
"""Number of random joint vectors per fruit; if too few of them hold the arm's tool upright, the study is refused."""

AT_ONCE = 4
"""Number of random joint vectors drawn per fruit at a time. About two in five hold a shipped arm's tool upright."""

TRIED = 5
"""Number of arms with which the numbers of poses are tried before a study begins."""


@dataclass(frozen=True, eq=False)
class Circumstances:
    """The fruit, calibration poses and tracker errors of one arm, which are the same in every setting.

    Attributes:
        number: Number of the arm in its population, from 0.
        fruit: Joints with which the nominal arm reaches each of the M fruit ``(M, n)``, rad or m.
        poses: Joints of the calibration poses ``(P, n)``, rad or m, from a Halton sequence. P is the largest number of
            poses of any setting; a setting with fewer poses uses the first of them.
        tracker: Standard normal draws for the tracker's errors at the calibration poses, and for the arm's friction.
    """

    number: int
    fruit: Array
    poses: Array
    tracker: NormalDraws

    @property
    def perfect(self) -> Circumstances:
        """These circumstances with all random errors of tracker and friction set to 0."""
        return replace(self, tracker=NormalDraws(*(np.zeros_like(part) for part in self.tracker)))


@dataclass(frozen=True, eq=False)
class Protocol:
    """A study that is ready to run.

    Attributes:
        config: The study's configuration.
        settings: The settings of the study.
        design: The plant that arms are drawn from, that is the nominal arm with its effects.
        tolerances: Tolerance classes by name.
        model: Error model whose parameters least squares identifies.
        tracker: Instrument that measures the arms; the method `instrument` returns it with the noise of a setting.
    """

    config: StudyConfig
    settings: tuple[Setting, ...]
    design: Plant
    tolerances: Mapping[str, Tolerances]
    model: ErrorModel
    tracker: Instrument

    @property
    def nominal(self) -> Geometry:
        """The nominal geometry of the design, which the controller assumes."""
        return self.design.arm.nominal

    def populations(self) -> list[list[Setting]]:
        """Return the settings as one list per population, that is per tolerance class and grade."""
        groups = groupby(self.settings, key=lambda setting: (setting.tolerances, setting.it_grade))
        return [list(group) for _, group in groups]

    def draw(self, setting: Setting, arms: range) -> Plant:
        """Draw the arms with the numbers ``arms``, from 0, of a setting's population, as one plant."""
        parent = np.random.SeedSequence(self.config.seed, spawn_key=(ARM_STREAM,), n_children_spawned=arms.start)
        tolerances = replace(self.tolerances[setting.tolerances], it_grade=setting.it_grade)
        return draw_plants(self.design, tolerances, len(arms), np.random.default_rng(parent))

    def circumstances(self, arm: int) -> Circumstances:
        """Return fruit, calibration poses and tracker errors of the arm with the number ``arm``, from 0.

        Raises:
            InputError: If too few random joint vectors hold the tool of the nominal arm upright.
        """
        count = max((setting.poses for setting in self.settings), default=0)
        return Circumstances(
            number=arm,
            fruit=_upright_joints(self.nominal, self.config.fruit, self.stream(FRUIT_STREAM, arm)),
            poses=spread_joints(self.nominal, count, self.stream(POSES_STREAM, arm)),
            tracker=normal_draws(self.design, count, self.stream(TRACKER_STREAM, arm)),
        )

    def instrument(self, setting: Setting) -> Instrument:
        """Return the instrument that measures the arms of a setting, with the setting's noise."""
        noise = MeasurementNoise(setting.noise_mm * 1e-3, math.radians(setting.noise_deg))
        return replace(self.tracker, noise=noise)

    def stream(self, purpose: int, arm: int) -> np.random.Generator:
        """Return the random generator of an arm for one purpose.

        Args:
            purpose: `TRACKER_STREAM`, `FRUIT_STREAM`, `POSES_STREAM` or `RESIDUAL_STREAM`.
            arm: The arm's number, from 0.
        """
        return np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=(purpose, arm)))


def prepared_study(config: StudyConfig) -> Protocol:
    """Load everything that a study needs, and check with a few arms that it can be run.

    Fruit must exist in the workspace, and the poses must suffice for a calibration.

    Raises:
        InputError: If a plant, instrument or tolerance class does not exist, or its file has a refused value. Also if
            the poses are too few for a calibration, or too few random joint vectors hold the tool upright.
    """
    design = config.load_plant()
    model, tracker = link_model(design.arm.nominal), load_instrument(config.instrument)
    protocol = Protocol(config, config.settings(), design, config.load_tolerances(), model, tracker)
    ideal = Plant(design.name, design.arm, design.arm.nominal)
    calibrated = {setting.poses: setting for setting in protocol.settings if setting.poses}
    for arm in range(TRIED if calibrated else 1):
        perfect = protocol.circumstances(arm).perfect
        for setting in calibrated.values():  # of an arm as its controller believes, by a tracker that does not err
            identify(protocol.model, protocol.nominal, measured(protocol, ideal, setting, perfect))
    return protocol


def measured(protocol: Protocol, arm: Plant, setting: Setting, around: Circumstances) -> Measurements:
    """Simulate the setting's tracker, which reads the true arm ``arm`` at the calibration poses in ``around``."""
    instrument, poses = protocol.instrument(setting), setting.poses
    return tracked(arm, instrument, around.poses[:poses], around.tracker.first(poses))


def carrying(plant: Plant, payload_kg: float) -> Plant:
    """Return the plant (a true arm) with a mass held at its tool, or unchanged if it has no link masses."""
    return plant if plant.load is None else replace(plant, load=replace(plant.load, payload=payload_kg))


def spread_joints(nominal: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Return joints ``(count, n)``, rad or m, that cover the joint ranges uniformly (a scrambled Halton sequence)."""
    if not count:
        return np.empty((0, nominal.joints))
    return np.asarray(qmc.scale(qmc.Halton(nominal.joints, rng=rng).random(count), nominal.lower, nominal.upper))


def _upright_joints(nominal: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Return joints ``(count, n)``, rad or m, drawn uniformly among all joints that hold the tool nearly upright.

    The tilt is at most `MAX_TILT`. The margin `GOAL_MARGIN`, a share of a joint's range, is left free at both limits.
    """
    margin = GOAL_MARGIN * (nominal.upper - nominal.lower)
    inner = replace(nominal, lower=nominal.lower + margin, upper=nominal.upper - margin)
    upright = np.empty((0, nominal.joints))
    for _ in range(DRAWS // AT_ONCE):
        joints = random_joints(inner, AT_ONCE * count, rng)
        steep = forward(nominal, joints).rotation[:, 2, 2] >= math.cos(MAX_TILT)
        upright = np.concatenate([upright, joints[steep]])
        if len(upright) >= count:
            return upright[:count]
    raise InputError(
        f"of {DRAWS * count} joint poses only {len(upright)} hold the tool within {math.degrees(MAX_TILT):.0f} deg of "
        f"the vertical, too few for {count} fruit; give another arm"
    )


# How each drawn arm differs from its design: the columns that sensitivity analyses start from. ``delta_PARAMETER_mm``
# or ``_deg``: true minus nominal; ``size_EFFECT``: factor on the design's size; ``sine_EFFECT`` and
# ``cosine_EFFECT``: that factor times sine and cosine of the phase, as a periodic error acts; ``rise_K``: the warm
# arm's temperature rise. Numbers that change nothing at rest (frequencies, time constants) are left out.


SIZES: Mapping[str, tuple[str, Callable[[Any], tuple[Any, ...]]]] = {
    "joint_stiffness": ("joint_compliance", lambda effect: effect.stiffness),
    "flexural_rigidity": ("boom_bending", lambda effect: (effect.flexural_rigidity,)),
    "torsional_rigidity": ("boom_torsion", lambda effect: (effect.torsional_rigidity,)),
    "bearing_stiffness": ("slide_compliance", lambda effect: tuple(bearing.stiffness for bearing in effect.bearings)),
    "lead": ("transmission_error", lambda effect: effect.lead),
    "roller_clearance": ("roller_play", lambda effect: (effect.clearance,)),
    "backlash": ("backlash", lambda effect: effect.width),
    "friction_forward": ("stick_band", lambda effect: effect.forward),
    "friction_backward": ("stick_band", lambda effect: effect.backward),
    "ground_stiffness": ("base_tilt", lambda effect: effect.stiffness),
    "creep": ("base_tilt", lambda effect: (effect.creep,)),
    "settlement": ("base_tilt", lambda effect: (effect.settlement,)),
}
"""For each column of sizes (parameters of effects), the effect, and a function that returns the effect's parameters.
Effects that give their own sizes, such as effects of other packages, have columns named after the effect."""


def deviations(design: Plant, arms: Plant) -> dict[str, Array]:
    """Return the deviations of drawn arms from the plant that they were drawn from, as columns.

    Args:
        design: The plant that the arms were drawn from.
        arms: The N arms, as one plant whose parameters are arrays over arms.

    Returns:
        Columns ``(N,)`` by name. Parameters that are zero in the design, and so in every arm, have no column.
    """
    nominal = design.arm.nominal
    names = iter(nominal.parameter_names)
    columns: dict[str, Array] = {}
    for kind in ("alpha", "a", "theta", "d"):
        difference = getattr(arms.geometry, kind) - getattr(nominal, kind)
        angle = kind in ("alpha", "theta")
        for i in range(nominal.joints):
            column = f"delta_{next(names)}_{'deg' if angle else 'mm'}"
            columns[column] = np.degrees(difference[:, i]) if angle else 1e3 * difference[:, i]
    foreign = {effect.name: (effect.name, type(effect).own_sizes) for effect in design.effects if effect.own_sizes()}
    for name, (effect, numbers) in {**SIZES, **foreign}.items():
        if design.effect(effect) is None:
            continue
        sizes = numbers(design.effect(effect))
        for i, (size, values) in enumerate(zip(sizes, numbers(arms.effect(effect)), strict=True), start=1):
            if size:
                columns[f"size_{name}_{i}" if len(sizes) > 1 else f"size_{name}"] = values / size
    drives, thermal = arms.effect("transmission_error"), arms.effect("thermal_growth")
    if drives is not None:
        pairs = zip(design.effect("transmission_error").harmonics, drives.harmonics, strict=True)
        for i, (nominal_term, term) in enumerate(pairs, start=1):
            if nominal_term.amplitude:
                size = term.amplitude / nominal_term.amplitude
                columns[f"sine_transmission_error_{i}"] = size * np.sin(term.phase)
                columns[f"cosine_transmission_error_{i}"] = size * np.cos(term.phase)
    if thermal is not None:
        columns["rise_K"] = np.asarray(thermal.final_rise)
    return columns


# Arms calibrated and judged one by one, with the same functions as a real arm's calibration: the reference.


OK = "ok"
"""Status of an arm that was calibrated and judged; any other status is a sentence that says why it was not."""
NOT_FINITE = "the simulated arm has no finite pose at some fruit"
ERROR = "error_mean_mm"
FIGURES = (ERROR, "error_rms_mm", "error_p50_mm", "error_p95_mm", "error_max_mm", "attitude_mean_deg")
"""Columns of errors over an arm's fruit. These columns and ``share_within`` are NaN if the status is not `OK`."""


def outcomes_of(
    setting: Setting, status: Sequence[str], iterations: Sequence[int], position: Array, attitude: Array
) -> Rows:
    """Return the outcomes of N arms in one setting, one row for each arm, with the setting's columns first.

    Args:
        setting: The setting.
        status: For each arm, `OK` or the reason why it could not be judged ``(N,)``.
        iterations: Number of least-squares iterations of each arm ``(N,)``.
        position: Distance of the tool's true position from the wanted one at each of M fruit ``(N, M)``, m; arbitrary
            if the status is not `OK`.
        attitude: Angle between the tool's true attitude and the wanted one at each fruit ``(N, M)``, rad; arbitrary
            if the status is not `OK`.
    """
    columns = {
        name: np.full(len(status), value, dtype=np.int32 if isinstance(value, int) else None)
        for name, value in setting.columns().items()
    }
    columns |= {"status": np.array(status), "iterations": np.asarray(iterations, dtype=np.int32)}
    return Rows(columns | {"position": position, "attitude": attitude})


Judge: TypeAlias = Callable[[Protocol, Sequence[Setting], Plant, Sequence[Circumstances]], list[Rows]]
"""Function that judges a batch of arms of one population, each in its own circumstances, and returns their outcomes in
each setting, such as `judge_arms` and `pickenv.experiments.study_batched.judge_batch`."""


def judge_arms(
    protocol: Protocol, settings: Sequence[Setting], plants: Plant, around: Sequence[Circumstances]
) -> list[Rows]:
    """Calibrate and judge a batch of arms, one arm at a time; arguments and result are as for `judge_batch`."""
    outcomes = [evaluate_arm(protocol, settings, plant_at(plants, i), met) for i, met in enumerate(around)]
    return [joined(parts) for parts in zip(*outcomes, strict=True)]


@single_threaded()
def evaluate_chunk(protocol: Protocol, chunk: int, rng: object = None, judge: Judge = judge_arms) -> Rows:
    """Draw the arms of a chunk from each population, judge them, and return their rows.

    Args:
        protocol: The study.
        chunk: Index of the chunk, from 0.
        rng: Not used: random numbers follow from the study's seed and the arms' numbers.
        judge: Function that calibrates and judges the arms of one population.

    Returns:
        One row for each arm and setting, sorted by arm and then by setting.
    """
    arms, parts = protocol.config.arms_of(chunk), list[dict[str, Any]]()
    around = [protocol.circumstances(arm) for arm in arms]
    for settings in protocol.populations():
        plants = protocol.draw(settings[0], arms)
        of_arms = deviations(protocol.design, plants)
        outcomes = judge(protocol, settings, plants, around)
        parts += [_columns(arms, each, protocol.config.radius_mm) | of_arms for each in outcomes]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.lexsort((columns["setting"], columns["arm"]))
    return Rows({name: values[order] for name, values in columns.items()})


def evaluate_arm(protocol: Protocol, settings: Sequence[Setting], arm: Plant, around: Circumstances) -> list[Rows]:
    """Calibrate and judge one true arm in several settings.

    Args:
        protocol: The study.
        settings: The settings. Their tolerances are not used, so the arm may be drawn from any population.
        arm: The plant, that is the true arm with its errors.
        around: Fruit, calibration poses and tracker errors of the arm.

    Returns:
        For each setting, the outcomes of this one arm.
    """
    command = cache(lambda calibration: arm_commands(protocol, calibration, arm, around))
    outcomes = []
    targets = forward(protocol.nominal, around.fruit)
    for setting in settings:
        joints, status, iterations = command(setting.calibration)
        error = pose_error(targets, carrying(arm, setting.payload_kg).tool_pose(joints))
        position, attitude = (np.linalg.norm(part, axis=1)[None] for part in (error[:, :3], error[:, 3:]))
        outcomes.append(outcomes_of(setting, [status], [iterations], position, attitude))
    return outcomes


def arm_commands(protocol: Protocol, setting: Setting, arm: Plant, around: Circumstances) -> tuple[Array, str, int]:
    """Calibrate the true arm ``arm`` as a setting says, and return its corrected joint commands for the fruit.

    The fruit, the calibration poses and the tracker's errors are in ``around``.

    Returns:
        Three values. The first is the joint commands for M fruit ``(M, n)``, rad or m. The second is `OK`, or the
        reason why the arm cannot be calibrated or judged. The third is the number of least-squares iterations.
    """
    if setting.method == RAW:
        return around.fruit, OK, 0
    try:
        compensator, iterations = _calibrated(protocol, setting, arm, around)
    except InputError as error:
        return around.fruit, str(error), 0
    except np.linalg.LinAlgError as error:
        return around.fruit, f"the identification broke down: {error}", 0
    joints, targets = compensator(around.fruit), forward(protocol.nominal, around.fruit).position
    miss = np.linalg.norm(compensator.predict(joints).position - targets, axis=1)
    missed = int(np.sum(miss > 1e-3 * protocol.config.radius_mm))
    return joints, reach_status(missed, protocol.config), iterations


def _calibrated(protocol: Protocol, setting: Setting, arm: Plant, around: Circumstances) -> tuple[Compensator, int]:
    """Calibrate the true arm ``arm`` at the poses in ``around``; return compensator and number of iterations."""
    identified = identify_converged(protocol.model, protocol.nominal, measured(protocol, arm, setting, around))
    iterations = len(identified.residual_rms) - 1
    _, _, kind = setting.method.partition(f"{LS}+")
    if not kind:
        return Compensator(protocol.nominal, identified.geometry), iterations
    rng = protocol.stream(RESIDUAL_STREAM, around.number)
    joints = spread_joints(protocol.nominal, protocol.config.residual_poses, rng)
    further = simulated_tracker(arm, joints, rng, protocol.instrument(setting))
    targets = further.difference(identified.arm_model)
    learnt = fit_residual(kind, further.joints, targets, further.prismatic, rng)
    model = ArmModel.of(identified.geometry)
    calibration = Calibration(protocol.design.arm.name, protocol.nominal, protocol.nominal, model, learnt, record={})
    return calibration.compensator(), iterations


def reach_status(missed: int, config: StudyConfig) -> str:
    """Return `OK`, or a sentence if too many fruit are out of an arm's reach to judge the arm.

    Args:
        missed: Number of fruit that the arm's own calibration predicts to miss by more than the specified radius.
        config: The study's configuration.
    """
    if (config.fruit - missed) / config.fruit >= config.share:
        return OK
    return (
        f"{missed} of {config.fruit} fruit are out of this arm's reach: by its calibration its commands end more than "
        f"{config.radius_mm:g} mm away"
    )


def figures(position: Array, attitude: Array, radius_mm: float) -> dict[str, Array]:
    """Compute statistics of N arms from their errors at M fruit, as columns ``(N,)`` by name.

    The columns are `FIGURES`, and "share_within", the share of fruit with position errors up to the specified radius.

    Args:
        position: Position errors ``(N, M)``, m.
        attitude: Attitude errors ``(N, M)``, rad.
        radius_mm: The specified radius, mm.
    """
    position_mm = 1e3 * np.ascontiguousarray(position)
    median, p95 = np.percentile(position_mm, [50, 95], axis=1)
    mean, rms = position_mm.mean(axis=1), np.sqrt(np.mean(position_mm**2, axis=1))
    mean_attitude = np.degrees(np.ascontiguousarray(attitude).mean(axis=1))
    values = (mean, rms, median, p95, position_mm.max(axis=1), mean_attitude)
    return dict(zip(FIGURES, values, strict=True)) | {"share_within": np.mean(position_mm <= radius_mm, axis=1)}


def _columns(arms: range, outcomes: Rows, radius_mm: float) -> dict[str, Any]:
    columns: dict[str, Any] = {"setting": None, "arm": np.arange(arms.start, arms.stop)} | dict(outcomes.columns)
    position, attitude = columns.pop("position"), columns.pop("attitude")
    finite = np.isfinite(position + attitude).all(axis=1)
    columns["status"] = np.where((columns["status"] == OK) & ~finite, NOT_FINITE, columns["status"])
    columns |= {name: np.full(len(arms), np.nan) for name in (*FIGURES, "share_within")}
    is_ok = columns["status"] == OK
    if is_ok.any():
        for name, values in figures(position[is_ok], attitude[is_ok], radius_mm).items():
            columns[name][is_ok] = values
    return columns
