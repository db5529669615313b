"""What a column description's file holds, table by table; `description` says what it means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY
from typing import Annotated, Any, get_args

from pickenv.calibration.camera.boards import Board
from pickenv.calibration.model.measurements import ATTITUDE_STD
from pickenv.calibration.model.pixels import Mount
from pickenv.calibration.reading.conventions import CONVENTIONS
from pickenv.calibration.reading.kind_tables import (
    ANGLES,
    COLUMN,
    COLUMNS,
    LENGTHS,
    BarTable,
    ContactTable,
    DialTable,
    LengthsTable,
    RadiusTable,
    ReflectorsTable,
    SocketsTable,
    TiltTable,
    WireTable,
    one_of,
)
from pickenv.errors import InputError
from pickenv.texts import shortened
from pickenv.toml_tables import DEG, NUMBER, WHOLE, Check, Key, Unit, toml_table

KINDS = (
    *("position", "reflectors", "wire", "bar", "sphere", "edge", "plane", "dial", "touches", "sockets", "tilt"),
    "pixels",
)
LENSES = ("fixed", "free", "prior")
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
"""How many columns each kind of section needs; one that is not here has none."""
JOINT_UNIT = one_of(LENGTHS + ANGLES)


def _separates(value: Any) -> bool:
    fit = isinstance(value, str) and len(value) == 1 and (value == "\t" or value.isprintable())
    return fit and value not in '"+-.' and not value.isalnum()


@toml_table
class JointsTable:
    """[joints]: one unit for all, or one each."""

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, JOINT_UNIT] | None = None
    units: Annotated[tuple[Annotated[str, JOINT_UNIT], ...], COLUMNS] | None = None

    def __post_init__(self) -> None:
        if self.units is None and self.unit is None:
            raise InputError(f"unit of [joints] is missing; give {JOINT_UNIT.wanted}")
        if len(self.each) != len(self.columns):
            counts = f"{len(self.columns)} columns but {len(self.each)} units"
            raise InputError(f"[joints] has {counts}; give one per joint")

    @property
    def each(self) -> tuple[str, ...]:
        """The unit of each column."""
        return (str(self.unit),) * len(self.columns) if self.units is None else self.units


@toml_table
class PixelsTable:
    """[pixels]: views of a board, as pictures or as a table of corners found in them."""

    _: KW_ONLY
    mount: Annotated[Mount, one_of(get_args(Mount))]
    picture: Annotated[str, COLUMN] | None = None
    files: Annotated[str, COLUMN] | None = None
    position: Annotated[tuple[str, ...], COLUMNS, Key("columns")] = ()
    view: Annotated[str, COLUMN] | None = None
    corner: Annotated[str, COLUMN] | None = None
    std_px: Annotated[float, Unit("px").positive, Key("std_px")] | None = None

    def __post_init__(self) -> None:
        if (self.picture is None) == (not self.position):
            raise InputError("[pixels] needs either picture, or columns, view and corner of a table of corners")
        if self.position and (self.view is None or self.corner is None):
            raise InputError("columns of [pixels] need view and corner: which picture, and which corner of the board")


Section = LengthsTable | ContactTable | TiltTable | PixelsTable
"""What was measured."""


@toml_table
class LensTable:
    """[camera]: the lens, by a file or by its numbers, and whether it is to be fitted."""

    _: KW_ONLY
    file: Annotated[str, COLUMN] | None = None
    fx: Annotated[float, PIXELS] | None = None
    fy: Annotated[float, PIXELS] | None = None
    cx: Annotated[float, PIXELS] | None = None
    cy: Annotated[float, PIXELS] | None = None
    width: Annotated[int, WHOLE.at_least(1)] | None = None
    height: Annotated[int, WHOLE.at_least(1)] | None = None
    distortion: Annotated[tuple[float, ...], NUMBER] = ()
    lens: Annotated[str, one_of(LENSES)] = "fixed"
    prior_px: Annotated[float, PIXELS, Key("prior_px")] = 10.0
    prior_distortion: Annotated[float, NUMBER] = 0.1

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, self.width, self.height)
        if self.file is None and any(number is None for number in numbers):
            raise InputError("[camera] needs file, or fx, fy, cx, cy, width and height")
        if self.file is not None and any(number is not None for number in numbers):
            raise InputError("[camera] has a file and numbers as well; give one of them")
        if len(self.distortion) not in (0, 4, 5):
            raise InputError(f"distortion of [camera] has {len(self.distortion)} numbers; give k1, k2, p1, p2 and k3")


@toml_table
class RotationTable:
    """[rotation]; a convention that is not named stays None, and is asked for when the file is read."""

    rotation: Annotated[tuple[str, ...], COLUMNS, Key("columns")]
    rotation_unit: Annotated[Any, Key("unit")] = None
    convention: Annotated[str, one_of(CONVENTIONS)] | None = None
    attitude_std: Annotated[float, DEG.positive, Key("std_deg")] = ATTITUDE_STD

    def unit(self) -> str:
        """The unit of angles, rad for a quaternion; columns that are no attitude, and a missing unit, are refused."""
        count = len(self.rotation)
        if self.convention is None and count not in (3, 4):
            raise InputError(f"[rotation] has {count} columns; give three angles or four of a quaternion")
        if not (count == 3 if self.convention is None else CONVENTIONS[self.convention][0] == "angle"):
            return "rad"
        if self.rotation_unit not in ANGLES:
            given = "missing" if self.rotation_unit is None else shortened(repr(self.rotation_unit))
            raise InputError(f"unit of [rotation] is {given}; give {one_of(ANGLES).wanted}")
        return str(self.rotation_unit)


@toml_table
class PosesTable:
    """[poses]: finished poses of the flange in place of joints, as the controller reports them."""

    _: KW_ONLY
    position: Annotated[tuple[str, ...], COLUMNS, Key("columns")]
    unit: Annotated[str, one_of(LENGTHS)]
    rotation: Annotated[tuple[str, ...], COLUMNS, Key("rotation_columns")]
    rotation_unit: Annotated[str, one_of(ANGLES)] = "rad"
    convention: Annotated[str, one_of(CONVENTIONS)]


@toml_table
class TemperatureTable:
    """[conditions.temperature]."""

    column: Annotated[str, COLUMN]
    unit: Annotated[str, one_of(("degC", "K"))]
    reference: Annotated[float, NUMBER] | None = None


@toml_table
class PayloadTable:
    """[conditions.payload]."""

    column: Annotated[str, COLUMN]
    unit: Annotated[str, one_of(MASSES)]
    reference: Annotated[float, NUMBER] = 0.0


@toml_table
class TorquesTable:
    """[conditions.torques]: one unit for all, or one each; else N*m for joints that turn, N for those that slide."""

    columns: Annotated[tuple[str, ...], COLUMNS]
    unit: Annotated[str, one_of(TORQUES)] | None = None
    units: Annotated[tuple[Annotated[str, one_of(TORQUES)], ...], COLUMNS] | None = None

    @property
    def each(self) -> tuple[str, ...] | None:
        """The unit of each column, where one is given."""
        return self.units if self.units or self.unit is None else (self.unit,) * len(self.columns)


@toml_table
class ConditionsTable:
    """[conditions]."""

    temperature: TemperatureTable | None = None
    payload: PayloadTable | None = None
    torques: TorquesTable | None = None


@toml_table
class DescriptionFile:
    """What a column description holds: exactly one of the sections of `KINDS`."""

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
    edge: RadiusTable | None = None
    plane: ContactTable | None = None
    dial: DialTable | None = None
    touches: ContactTable | None = None
    sockets: SocketsTable | None = None
    tilt: TiltTable | None = None
    pixels: PixelsTable | None = None
    board: Board | None = None
    camera: LensTable | None = None
    poses: PosesTable | None = None
    rotation: RotationTable | None = None
    conditions: ConditionsTable = ConditionsTable()

    def __post_init__(self) -> None:
        if self.decimal == self.separator:
            raise InputError(f"decimal is {self.decimal!r}; give '.' or ',', and not the separator")
        kinds = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(kinds) > 1:
            raise InputError(f"sections [{kinds[0]}] and [{kinds[1]}] are both given; one file holds one kind")
        if not kinds:
            raise InputError("section [position] is missing; say what was measured in one of " + ", ".join(KINDS))
        self._check_views()
        fits, wanted = COUNTS.get(kinds[0], (lambda _: True, ""))
        if not fits(len(self.measured.position)):
            raise InputError(f"[{kinds[0]}] needs {wanted}")
        stds = len(getattr(self.measured, "position_std_columns", ()))
        if stds and stds != len(self.measured.position):
            counts = f"{len(self.measured.position)} columns but {stds} std_columns"
            raise InputError(f"[{kinds[0]}] has {counts}; give one each")
        if self.rotation is not None:
            if self.position is None:
                raise InputError(f"[rotation] belongs to [position], not to [{kinds[0]}]")
            self.rotation.unit()
        torques, n = self.conditions.torques, 0 if self.joints is None else len(self.joints.columns)
        if torques is not None and (len(torques.columns), len(torques.each or torques.columns)) != (n, n):
            raise InputError("[conditions.torques] needs one column, and one unit, per joint")

    def _check_views(self) -> None:
        """Joints or finished poses; a board and a camera where there are pictures, and nowhere else."""
        if (self.joints is None) == (self.poses is None):
            raise InputError("[joints] is missing" if self.poses is None else "[joints] and [poses] are both given")
        if self.poses is not None and self.pixels is None:
            raise InputError("[poses] belongs to [pixels]; give the joints in [joints]")
        if self.pixels is not None and self.conditions != ConditionsTable():
            raise InputError("[conditions] is not read for [pixels]; leave it out")
        for name, table in (("board", self.board), ("camera", self.camera)):
            if (table is None) != (self.pixels is None):
                fault = "is missing; [pixels] needs it" if table is None else "belongs to [pixels]"
                raise InputError(f"[{name}] {fault}")

    @property
    def kind(self) -> str:
        """What was measured, one of `KINDS`."""
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    @property
    def measured(self) -> Section:
        """The section of that kind."""
        section: Section = getattr(self, self.kind)
        return section
