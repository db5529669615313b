"""Column descriptions: a column description is a small TOML file that says how a foreign measurement file is laid out.

It names separator, decimal sign, units, conventions and uncertainties. One of its sections says what was measured:
[position] (poses, if [rotation] is there too), [reflectors], [wire], [touches] and so on. The folder `descriptions`
holds the descriptions that come with pickenv.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import KW_ONLY, make_dataclass
from math import inf
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np

from pickenv.arm import Array
from pickenv.base import DEG, MM, NUMBER, WHOLE, Check, InputError, Key, Then, Unit, shortened, toml_table, toml_tables
from pickenv.base.registry import load_all, names
from pickenv.calibration.camera.boards import DICTIONARIES, Board, one_of
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD, ROOM_TEMPERATURE
from pickenv.calibration.model.pixels import Mount
from pickenv.calibration.reading.table_files import CONVENTIONS, columns_of, expression_tree

# Tables of a column description that say what was measured, one class for each way of saying it.

LENGTHS, ANGLES = ("mm", "m"), ("deg", "rad")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
KNOWN, FITTED = "known", "fitted"
LOST = ("zeros", "empty")


DOUBT = Then(lambda word, _: inf if word == FITTED else 0.0, Annotated[str, one_of((KNOWN, FITTED))])
"""Converter of the word "known" or "fitted" into a standard uncertainty: 0 if known, infinite if fitted."""

COLUMN = Check(lambda value: isinstance(value, str), "the name of a column or an expression")
TOPIC = Check(lambda value: isinstance(value, str), "the name of a topic")
COLUMNS = Check(
    lambda value: isinstance(value, list) and all(isinstance(item, str) for item in value),
    "a list of column names or expressions",
)


def _lost(found: Any, _context: Any) -> tuple[str, ...]:
    marks = [found] if isinstance(found, str) else found
    if not isinstance(marks, list) or any(mark not in LOST for mark in marks):
        raise toml_tables.fault(f"how lost reflectors are marked, of {', '.join(LOST)}")
    return tuple(marks)


@toml_table
class LengthsTable:
    """Section [position]: the columns of x, y and z, with their unit.

    ``std`` is the standard uncertainty of a coordinate, m. ``std_columns`` hold the standard deviation of repeated
    measurements, one column for each coordinate.
    """

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, one_of(LENGTHS)]
    std: Annotated[float, MM.positive] | None = None
    std_columns: Annotated[tuple[str, ...], COLUMNS] = ()


@toml_table
class ReflectorsTable(LengthsTable):
    """Section [reflectors]: the columns of x, y and z of each reflector in turn.

    ``lost`` says how the file marks a reflector that the tracker lost ("zeros", "empty"). ``places`` are the
    reflectors' positions on the tool, m, if known, with the standard uncertainty ``places_std``, m.
    """

    lost: Annotated[tuple[str, ...], Then(_lost, Any)] = ()
    places: Annotated[tuple[float, ...], MM] = ()
    places_std: Annotated[float, MM.not_negative] = 1e-4

    def __post_init__(self) -> None:
        if self.places and len(self.places) != len(self.columns):
            counts = f"{len(self.places)} numbers for {len(self.columns)} columns"
            raise InputError(f"places_mm of [reflectors] has {counts}; give x, y and z of each reflector in turn")


@toml_table
class ContactTable:
    """Section [touches] or [plane], and the keys that all sections of contact measurements share.

    ``std`` is the standard uncertainty of a contact, m. ``tool_point`` is the position of the touching point in the
    tool frame, m. If ``tool`` is "known", this position has the standard uncertainty ``tool_std``, m. If ``tool`` is
    "fitted", the position is unknown. ``contact`` names a column that is 0 without contact.
    """

    _: KW_ONLY
    std: Annotated[float, MM.positive] = 1e-4
    tool: Annotated[str, one_of((KNOWN, FITTED))] = KNOWN
    tool_point: Annotated[tuple[float, float, float], MM, Key("tool_mm")] = (0.0, 0.0, 0.0)
    tool_std: Annotated[float, MM.not_negative] = 0.0
    contact: Annotated[str, COLUMN] | None = None

    @property
    def tip_std(self) -> float:
        """Standard uncertainty of the tool point, m; infinite if the tool point is to be fitted."""
        return inf if self.tool == FITTED else self.tool_std


@toml_table
class SocketsTable(ContactTable):
    """Section [sockets]: optional column of socket numbers, and spacing of paired sockets with its uncertainty, m."""

    columns: Annotated[tuple[str, ...], Then(lambda name, _: (name,), Annotated[str, COLUMN]), Key("column")] = ()
    spacing: Annotated[float, MM.positive] | None = None
    spacing_std: Annotated[float, MM.positive] = 5e-5


@toml_table
class WireTable(ContactTable):
    """Section [wire]: the column of the length of a draw wire from the tool to an anchor, with its scale and zero.

    ``zero`` is the reading at length 0, m. ``scale_std`` and ``zero_std`` are 0 for "known", infinite for "fitted".
    """

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, one_of(LENGTHS)]
    scale_std: Annotated[float, DOUBT, Key("scale")] = 0.0
    zero_std: Annotated[float, DOUBT, Key("zero")] = inf
    zero: Annotated[float, MM, Key("zero_mm")] = 0.0


@toml_table
class DialTable(ContactTable):
    """Section [dial]: the column of a dial gauge's reading along a fixed axis.

    ``free`` is the reading without contact, m. ``scale_std`` is 0 for a "known" scale, infinite for a "fitted" one.
    """

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, one_of(LENGTHS)]
    scale_std: Annotated[float, DOUBT, Key("scale")] = 0.0
    free: Annotated[float, MM] = 0.0


@toml_table
class BarTable(ContactTable):
    """Section [bar]: the length of a ball bar and its standard uncertainty, m; without a length, it is fitted."""

    length: Annotated[float, MM.positive] | None = None
    length_std: Annotated[float, MM.not_negative] = 0.0


@toml_table
class RadiusTable(ContactTable):
    """Section [sphere]: the tool point's distance from a fixed centre (fitted if left out), and its uncertainty, m."""

    length: Annotated[float, MM.positive, Key("radius_mm")] | None = None
    length_std: Annotated[float, MM.not_negative, Key("radius_std_mm")] = 0.0


@toml_table
class TiltTable:
    """Section [tilt]: the columns of an inclinometer's or accelerometer's axes.

    Each column holds the component of the downward direction along the axis, in g, or the axis's inclination, in deg or
    rad. ``axes_std`` is the uncertainty of the sensor's mount, and ``down_std`` the uncertainty of the downward
    direction in the base. Each is 0 if the file says "known", and infinite if it says "fitted".
    """

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, one_of((*ANGLES, "g"))]
    std: Annotated[float, DEG.positive] = 1e-3
    axes_std: Annotated[float, DOUBT, Key("mount")] = inf
    down_std: Annotated[float, DOUBT, Key("base")] = inf


# What a column description's file holds, table by table; `description` says what it means.


def kinds() -> tuple[str, ...]:
    """Return the kinds of measurement: one per registered instrument, and "pixels"; each is a section's name."""
    return (*names("instrument"), "pixels")


PIXELS = Unit(most=1e6).positive
MASSES = {"kg": 1.0, "g": 1e-3}
TORQUES = {"N*m": 1.0, "N": 1.0, "N*mm": 1e-3, "kN": 1e3}


COUNTS: dict[str, tuple[Callable[[int], bool], str]] = {
    "position": (lambda n: n == 3, "three columns, x, y and z"),
    "reflectors": (lambda n: n > 0 and n % 3 == 0, "three columns per reflector, x, y and z of each in turn"),
    "wire": (lambda n: n == 1, "one column, the length"),
    "dial": (lambda n: n == 1, "one column, the reading"),
    "tilt": (lambda n: 1 <= n <= 3, "one to three columns, one for each axis of the sensor"),
    "sockets": (lambda n: n <= 1, "the column that numbers the sockets"),
    "pixels": (lambda n: n in (0, 2), "two columns, across and down, where corners and not pictures are given"),
}
"""For each section with columns: a test of the number of columns, and words for messages that say which are needed."""
RECORDED = ("position", "reflectors", "wire", "dial", "tilt")
"""Kinds of measurement that can be recorded while the arm moves, since their readings follow the motion."""

JOINT_UNIT = one_of(LENGTHS + ANGLES)


def _separates(value: Any) -> bool:
    fit = isinstance(value, str) and len(value) == 1 and (value == "\t" or value.isprintable())
    return fit and value not in '"+-.' and not value.isalnum()


@toml_table
class JointsTable:
    """Section [joints]: the columns of the joint values, with one unit for all of them or one for each."""

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, JOINT_UNIT] | None = None
    units: Annotated[tuple[Annotated[str, JOINT_UNIT], ...], COLUMNS] | None = None

    def __post_init__(self) -> None:
        if self.units is None and self.unit is None:
            raise InputError(f"unit of [joints] is missing; give {JOINT_UNIT.wanted}")
        if self.units is not None and self.unit is not None:
            raise InputError("[joints] has unit and units; give one of them")
        n, units = len(self.columns), len(self.each)
        if units != n:
            raise InputError(f"[joints] has {n} columns but {units} units; give one per joint")

    @property
    def each(self) -> tuple[str, ...]:
        """The unit of each column."""
        return (str(self.unit),) * len(self.columns) if self.units is None else self.units


@toml_table
class PixelsTable:
    """Section [pixels]: views of a board, given as pictures or as a table of the corners detected in them.

    ``mount`` is "hand" for a camera on the tool, "world" for a fixed camera. ``picture`` names the column of the paths
    of pictures, or is a pattern of these paths. ``files`` is a pattern of the names of pose files. For a table of
    corners, ``columns`` names the columns of pixels across and down, ``view`` the column of the picture's name, and
    ``corner`` the column of the corner's number. ``std`` is the standard uncertainty of a corner's coordinate, px.
    """

    mount: Annotated[Mount, one_of(get_args(Mount))] | None = None
    picture: Annotated[str, COLUMN] | None = None
    files: Annotated[str, COLUMN] | None = None
    columns: Annotated[tuple[str, ...], COLUMNS] = ()
    view: Annotated[str, COLUMN] | None = None
    corner: Annotated[str, COLUMN] | None = None
    std: Annotated[float, Unit("px").positive] | None = None

    def __post_init__(self) -> None:
        if (self.picture is None) == (not self.columns):
            raise InputError("[pixels] needs either picture, or columns, view and corner of a table of corners")
        if self.columns and (self.view is None or self.corner is None):
            raise InputError("columns of [pixels] need view and corner: which picture, and which corner of the board")


@toml_table
class TargetTable:
    """Section [target]: positions of points on a rigid target, in the target's own frame, and the points' numbers.

    For a body with tags on its faces, the points are the corners of all tags. Without ``numbers``, points are numbered
    from 0. If ``dictionary`` names the tags' kind, the tags are found in pictures: the four corners of tag k, clockwise
    as OpenCV finds them, then have the numbers 4 k to 4 k + 3.
    """

    points: Annotated[tuple[float, ...], MM]
    numbers: Annotated[tuple[int, ...], WHOLE] = ()
    dictionary: Annotated[str, one_of(DICTIONARIES)] | None = None

    def __post_init__(self) -> None:
        count, rest = divmod(len(self.points), 3)
        if rest or count < 4:
            raise InputError(f"points_mm of [target] has {len(self.points)} numbers; give x, y and z of four or more")
        if self.numbers and (len(self.numbers), len(set(self.numbers))) != (count, count):
            raise InputError(f"numbers of [target] are not one for each of its {count} points; give each a number")
        if np.linalg.matrix_rank(self.places - self.places.mean(axis=0), tol=1e-6) < 2:
            raise InputError("points_mm of [target] lie in one line, which does not tell how the target is turned")

    @property
    def places(self) -> Array:
        """The points ``(K, 3)`` in the target's frame, m."""
        return np.reshape(self.points, (-1, 3))


@toml_table
class LensTable:
    """Section [camera]: the lens, given as a file or as numbers, and whether its numbers are fitted.

    With ``lens`` "fixed" the numbers are exact, with "free" unknown. With "prior" their standard uncertainties are
    ``prior_px`` for fx, fy, cx and cy, and ``prior_distortion`` for each distortion coefficient.
    """

    file: Annotated[str, COLUMN] | None = None
    fx: Annotated[float, PIXELS] | None = None
    fy: Annotated[float, PIXELS] | None = None
    cx: Annotated[float, PIXELS] | None = None
    cy: Annotated[float, PIXELS] | None = None
    width: Annotated[int, WHOLE.at_least(1)] | None = None
    height: Annotated[int, WHOLE.at_least(1)] | None = None
    distortion: Annotated[tuple[float, ...], NUMBER] = ()
    lens: Annotated[str, one_of(("fixed", "free", "prior"))] = "fixed"
    prior_px: Annotated[float, PIXELS] = 10.0
    prior_distortion: Annotated[float, NUMBER] = 0.1

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, self.width, self.height)
        if self.file is None and any(number is None for number in numbers):
            raise InputError("[camera] needs file, or fx, fy, cx, cy, width and height")
        if self.file is not None and (any(number is not None for number in numbers) or self.distortion):
            raise InputError("[camera] has a file and numbers as well; give one of them")
        if len(self.distortion) not in (0, 4, 5):
            raise InputError(f"distortion of [camera] has {len(self.distortion)} numbers; give k1, k2, p1, p2 and k3")


@toml_table
class RotationTable:
    """Section [rotation]: the columns of the attitude, with their unit, convention and standard uncertainty, rad.

    Without a convention, a measurement file is refused with a table of the errors that each convention would leave.
    """

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Any = None
    convention: Annotated[str, one_of(CONVENTIONS)] | None = None
    std: Annotated[float, DEG.positive] = ATTITUDE_STD

    def checked_unit(self, section: str = "rotation", key: str = "unit") -> str:
        """Return the unit of the angles; for a quaternion it is "rad", which leaves its numbers as they are.

        Messages name ``section``, the section that has these columns, and ``key``, the section's key for the unit.

        Raises:
            InputError: If the number of columns is not 3 or 4, or does not fit the convention. Also if the unit of
                angles is missing, or if a quaternion has a unit.
        """
        count = len(self.columns)
        if self.convention is None and count not in (3, 4):
            raise InputError(f"[{section}] has {count} columns; give three angles or four of a quaternion")
        wanted = count if self.convention is None else columns_of(self.convention)
        if count != wanted:
            raise InputError(f"convention '{self.convention}' needs {wanted} columns, but [{section}] has {count}")
        unit = "missing" if self.unit is None else shortened(repr(self.unit))
        if wanted == 4 and self.unit is not None:
            raise InputError(
                f"{key} of [{section}] is {unit}, but '{self.columns[0]}' begins a quaternion; leave it out"
            )
        if wanted == 3 and self.unit not in ANGLES:
            raise InputError(f"{key} of [{section}] is {unit}; give {one_of(ANGLES).wanted}")
        return str(self.unit or "rad")


@toml_table
class PosesTable:
    """Section [poses]: poses of the flange as the controller reports them, given in place of joint values."""

    _: KW_ONLY
    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, one_of(LENGTHS)]
    rotation_columns: Annotated[tuple[str, ...], COLUMNS]
    rotation_unit: Annotated[str, one_of(ANGLES)] | None = None
    convention: Annotated[str, one_of(CONVENTIONS)]

    def __post_init__(self) -> None:
        if len(self.columns) != 3:
            raise InputError(f"[poses] has {len(self.columns)} columns; give three, x, y and z")
        self.attitudes.checked_unit("poses", "rotation_unit")

    @property
    def attitudes(self) -> RotationTable:
        """The columns of the attitude as a section [rotation]."""
        return RotationTable(self.rotation_columns, self.rotation_unit, self.convention)


@toml_table
class TemperatureTable:
    """Section [conditions.temperature]: the column, its unit, and the reference that is subtracted, in that unit.

    Without a reference, 20 degC is subtracted if the unit is degC, and nothing if it is K.
    """

    column: Annotated[str, COLUMN]
    unit: Annotated[str, one_of(("degC", "K"))]
    reference: Annotated[float, NUMBER] | None = None


@toml_table
class PayloadTable:
    """Section [conditions.payload]: the column, its unit, and the reference that is subtracted, in that unit."""

    column: Annotated[str, COLUMN]
    unit: Annotated[str, one_of(MASSES)]
    reference: Annotated[float, NUMBER] = 0.0


@toml_table
class TorquesTable:
    """Section [conditions.torques]: the columns of the joint torques, with one unit for all of them or one for each.

    Without a unit, torques are in N*m for revolute joints and in N for prismatic ones.
    """

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, one_of(TORQUES)] | None = None
    units: Annotated[tuple[Annotated[str, one_of(TORQUES)], ...], COLUMNS] | None = None

    def __post_init__(self) -> None:
        if self.units and self.unit is not None:
            raise InputError("[conditions.torques] has unit and units; give one of them")

    @property
    def each(self) -> tuple[str, ...] | None:
        """The unit of each torque column; None if no unit is given."""
        return self.units if self.units or self.unit is None else (self.unit,) * len(self.columns)


Recorded = tuple[tuple[str, ...], tuple[float, ...], float]
"""A recorded condition: its columns, the factor from each column's unit to SI, and the reference in the
columns' unit. The reference is subtracted before the factor is applied."""


@toml_table
class ConditionsTable:
    """Section [conditions]: the temperature, payload and joint torques that the file records, each optional."""

    temperature: TemperatureTable | None = None
    payload: PayloadTable | None = None
    torques: TorquesTable | None = None

    def recorded(self, joint_units: tuple[str, ...]) -> dict[str, Recorded]:
        """Return the recorded conditions by name: "temperature", "payload", "torque".

        Torques without a unit are in N for joints in mm or m, else in N*m.

        Args:
            joint_units: Unit of each joint's column.
        """
        recorded: dict[str, Recorded] = {}
        if (warmth := self.temperature) is not None:
            usual = ROOM_TEMPERATURE if warmth.unit == "degC" else 0.0
            recorded["temperature"] = (warmth.column,), (1.0,), usual if warmth.reference is None else warmth.reference
        if (mass := self.payload) is not None:
            recorded["payload"] = (mass.column,), (MASSES[mass.unit],), mass.reference
        if (torques := self.torques) is not None:
            units = torques.each or tuple("N" if unit in LENGTHS else "N*m" for unit in joint_units)
            recorded["torque"] = torques.columns, tuple(TORQUES[unit] for unit in units), 0.0
        return recorded


@toml_table
class RecordingTable:
    """Section [recording]: the time column of the instrument's log, and the joint log that the arm wrote meanwhile.

    ``joints`` is the path of the joint log, relative to the folder of the instrument's file. In it, {file} stands for
    the name of the instrument's file without its ending. The instrument's log is a ROS bag if ``topic`` is named, the
    joint log if ``joints_topic`` is.
    """

    time: Annotated[str, COLUMN]
    unit: Annotated[str, one_of(SECONDS)]
    joints: Annotated[str, COLUMN]
    joints_time: Annotated[str, COLUMN]
    joints_unit: Annotated[str, one_of(SECONDS)]
    topic: Annotated[str, TOPIC] | None = None
    joints_topic: Annotated[str, TOPIC] | None = None


def _pairs(value: Any, _context: Any) -> tuple[tuple[str, str], ...]:
    if not isinstance(value, dict) or not all(isinstance(link, str) for link in value.values()):
        raise toml_tables.fault("names of sensors and targets, each with the name of its link")
    return tuple(value.items())


@toml_table
class SceneTable:
    """Section [scene]: names of sensor and target, and the links that carry them on a whole robot (a tree of links).

    Files that name the same sensor share one sensor pose. Files that name the same target share one target pose. A
    sensor or target without a name belongs to this file alone. A sensor or target without a link is fixed in the world.
    An inclinometer has no target.

    ``sensor_column`` and ``target_column`` hold the names row by row. If ``sensor`` is given as well, only the rows of
    this sensor are read; otherwise the rows of each name are a data set. The same holds for targets. ``links`` are the
    links of named sensors and targets; without an entry they are on ``sensor_link`` and ``target_link``.

    ``series_column`` holds names of series. The rows of a series are read like a separate file, so that the
    instrument or the tool may have moved between two series. With ``series``, only that series is read.
    """

    sensor: str = ""
    sensor_link: str = ""
    sensor_column: Annotated[str, COLUMN] | None = None
    target: str = ""
    target_link: str = ""
    target_column: Annotated[str, COLUMN] | None = None
    series: str = ""
    series_column: Annotated[str, COLUMN] | None = None
    links: Annotated[tuple[tuple[str, str], ...], Then(_pairs, Any)] = ()

    def __post_init__(self) -> None:
        names = self.sensor or self.target or self.sensor_column or self.target_column
        if self.series and self.series_column is None:
            raise InputError("series of [scene] is a name in its series_column, which is missing; give both")
        if self.series_column and names and not self.series:
            raise InputError(
                "series_column of [scene] is for a sensor and target without names, for a name says what was moved; "
                "leave it out, or name one series"
            )


@toml_table
class DescriptionFile:
    """Content of a column description; it has exactly one of the sections that `kinds` names."""

    joints: JointsTable | None = None
    description: str = ""
    separator: Annotated[str, Check(_separates, "one character, such as ',' or ';' or '\\t'")] = ","
    decimal: Annotated[str, one_of((".", ","))] = "."
    names: Annotated[tuple[str, ...], COLUMNS] | None = None
    position: LengthsTable | None = None
    reflectors: ReflectorsTable | None = None
    wire: WireTable | None = None
    bar: BarTable | None = None
    sphere: RadiusTable | None = None
    plane: ContactTable | None = None
    dial: DialTable | None = None
    touches: ContactTable | None = None
    sockets: SocketsTable | None = None
    tilt: TiltTable | None = None
    pixels: PixelsTable | None = None
    board: Board | None = None
    target: TargetTable | None = None
    camera: LensTable | None = None
    poses: PosesTable | None = None
    rotation: RotationTable | None = None
    conditions: ConditionsTable = ConditionsTable()
    recording: RecordingTable | None = None
    scene: SceneTable = SceneTable()

    def __post_init__(self) -> None:
        if self.decimal == self.separator:
            raise InputError(f"decimal is {self.decimal!r}; give '.' or ',', and not the separator")
        sections = [kind for kind in kinds() if getattr(self, kind, None) is not None]
        if len(sections) > 1:
            raise InputError(f"sections [{sections[0]}] and [{sections[1]}] are both given; one file holds one kind")
        if not sections:
            raise InputError("section [position] is missing; say what was measured in one of " + ", ".join(kinds()))
        if (self.joints is None) == (self.poses is None):
            raise InputError("[joints] is missing" if self.poses is None else "[joints] and [poses] are both given")
        if self.poses is not None and self.pixels is None:
            raise InputError("[poses] belongs to [pixels]; give the joints in [joints]")
        links = self.scene.sensor_link or self.scene.target_link or self.scene.links
        if self.pixels is not None and (self.pixels.mount is None) != bool(links):
            mounts = " or ".join(get_args(Mount))
            where = "the links of [scene] say where the camera is; leave it out" if links else f"give {mounts}"
            raise InputError(f"mount of [pixels] is {self.pixels.mount or 'missing'}: {where}")
        if self.pixels is not None and self.conditions != ConditionsTable():
            raise InputError("[conditions] is not read for [pixels]; leave it out")
        for name, table in (("board", self.board or self.target), ("camera", self.camera)):
            if (table is None) != (self.pixels is None):
                fault = "is missing; [pixels] needs it" if table is None else "belongs to [pixels]"
                raise InputError(f"[{name}] {fault}")
        if self.target is not None and self.board is not None:
            raise InputError("[target] stands in place of [board]; leave one of them out")
        if self.target is not None and self.pixels and (self.target.dictionary is None) == (not self.pixels.columns):
            fault = "belongs to pictures; leave it out" if self.pixels.columns else "is missing; pictures need it"
            raise InputError(f"dictionary of [target] {fault}")
        fits, columns = COUNTS.get(sections[0], (lambda _: True, ""))
        count = len(self.columns)
        if not fits(count):
            raise InputError(f"[{sections[0]}] needs {columns}")
        stds = len(getattr(self.measured, "std_columns", ()))
        if stds and stds != count:
            raise InputError(f"[{sections[0]}] has {count} columns but {stds} std_columns; give one each")
        if self.rotation is not None:
            if self.position is None:
                raise InputError(f"[rotation] belongs to [position], not to [{sections[0]}]")
            self.rotation.checked_unit()
        if self.recording is not None and sections[0] not in RECORDED:
            raise InputError(f"[recording] is not for [{sections[0]}]; give one row per pose, or {', '.join(RECORDED)}")
        if self.recording is not None and getattr(self.measured, "contact", None) is not None:
            raise InputError(f"contact of [{sections[0]}] is not read in a recording; leave one of them out")
        torques, n = self.conditions.torques, 0 if self.joints is None else len(self.joints.columns)
        if torques is not None and (len(torques.columns), len(torques.each or torques.columns)) != (n, n):
            raise InputError("[conditions.torques] needs one column, and one unit, per joint")

    @property
    def kind(self) -> str:
        """Name of the section that says what was measured, one of `kinds`."""
        return next(kind for kind in kinds() if getattr(self, kind, None) is not None)

    @property
    def measured(self) -> Any:
        """The section that says what was measured; its class depends on the kind."""
        return getattr(self, self.kind)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns or expressions of the section that says what was measured, such as x, y and z, a length, or a tilt.

        Empty for a section that another package reads, because only that package knows its keys.
        """
        return getattr(self.measured, "columns", ()) if self.kind in COUNTS else ()

    @property
    def target_points(self) -> tuple[Array, tuple[int, ...]]:
        """The points of the board or target ``(K, 3)``, m, in its frame, and their numbers (a board's are from 0)."""
        if self.target is None:
            assert self.board is not None
            return self.board.corners, tuple(range(len(self.board.corners)))
        return self.target.places, self.target.numbers or tuple(range(len(self.target.places)))

    @property
    def ends(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """Names of the two ends of a measured pose, and the links that carry these ends.

        The first end is the sensor, and the second is the target. For a camera that the arm carries, and for an
        inclinometer, the first end is the target, and the second is the sensor.
        """
        scene, links_of = self.scene, dict(self.scene.links)
        names = (scene.sensor, scene.target)
        links = (links_of.get(scene.sensor, scene.sensor_link), links_of.get(scene.target, scene.target_link))
        back = self.tilt is not None or (self.pixels is not None and self.pixels.mount == "hand")
        return (names[::-1], links[::-1]) if back else (names, links)

    @property
    def unit(self) -> str:
        """Unit of `columns`: "mm" or "m", for a tilt "deg", "rad" or "g"; empty if the section has no unit."""
        return getattr(self.measured, "unit", "")

    @property
    def std(self) -> float:
        """Standard uncertainty of one reading: m for a coordinate, a length or a contact, rad for a tilt."""
        return getattr(self.measured, "std", None) or POSITION_STD

    @property
    def joint_columns(self) -> tuple[str, ...]:
        """Columns or expressions of the joint values, in joint order; empty if tool poses are given in their place."""
        return () if self.joints is None else self.joints.columns

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each of the `joint_columns`."""
        return () if self.joints is None else self.joints.each


def description_file() -> type[DescriptionFile]:
    """Return the class into which column descriptions are read.

    Each instrument of another package adds a field, which is a section of the file. The reader of the instrument has a
    parameter ``section``, and the annotation of this parameter is the section's class.
    """
    readers = {name: reader for name, reader in load_all("instrument").items() if not hasattr(DescriptionFile, name)}
    sections = [(name, get_type_hints(reader)["section"] | None, None) for name, reader in readers.items()]
    if not sections:
        return DescriptionFile
    return toml_table(make_dataclass("DescriptionFile", sections, bases=(DescriptionFile,), frozen=True))


DESCRIPTIONS = Path(__file__).parent / "descriptions"


def load_description(name: str | Path) -> DescriptionFile:
    """Read a column description by name (a shipped one) or from a path to a TOML file.

    Raises:
        InputError: If the description is unknown or malformed; the message names the file and key.
    """
    path = description_path(name)
    description = toml_tables.read_toml(description_file(), path)
    _refuse_repeats(description, path)
    return description


def description_path(name: str | Path) -> Path:
    """Return the path of a column description that is given by name or by path."""
    return toml_tables.file_named("column description", name, DESCRIPTIONS)


def _refuse_repeats(description: DescriptionFile, path: Path) -> None:
    """Refuse a description that gives one column for two quantities; a fit may not reveal this fault."""
    roles = [(f"joint {i + 1}", text) for i, text in enumerate(description.joint_columns)]
    sections = {description.kind: description.columns}
    if description.rotation is not None:
        sections["rotation"] = description.rotation.columns
    if (poses := description.poses) is not None:
        sections["poses"] = (*poses.columns, *poses.rotation_columns)
    for name, (columns, *_) in description.conditions.recorded(description.joint_units).items():
        sections[f"conditions.{name}"] = columns
    for section, columns in sections.items():
        roles += [(f"column {i + 1} of [{section}]", text) for i, text in enumerate(columns)]
    roles_of: dict[str, str] = {}
    for role, text in roles:
        tree = expression_tree(text)
        plain = text.strip() if tree is None else ast.dump(tree)
        if plain in roles_of:
            raise InputError(
                f"{path}: '{shortened(text)}' is given for {roles_of[plain]} and for {role}; name each column once"
            )
        roles_of[plain] = role
