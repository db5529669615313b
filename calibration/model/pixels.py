"""Pixels of a target's points, in pictures of a camera that is on the arm's tool or watches a target on the tool.

A target is a printed board, whose points are its corners, or any list of points in space. The instrument's frame is the
target's frame if the camera is on the tool. It is the camera's frame if the camera watches a target on the tool. One
of the two objects, camera and target, is fixed in the world, and the other is on the flange. The fitted base gives the
pose of the fixed object, and the fitted tool the pose of the object on the flange. The only unknowns of this kind are
the numbers of the lens, if they are fitted. SI units; pictures in px.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pickenv.arm import Array, Pose, inverse_pose, rotation_matrix
from pickenv.base import InputError, register
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, Origins, Rows, Stated, point_jacobian

# What a camera makes of a point: a pinhole, and the radial and tangential distortion of its lens. Brown 1971, with
# the coefficients as OpenCV and ROS ("plumb_bob") order them: k1, k2, p1, p2, k3. Points lie in the camera's frame (x
# right, y down, z along the view), m; pictures are in pixels, the centre of the first pixel at (0, 0).

LENS_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Names of a lens' numbers: focal lengths and principal point in px, distortion without unit."""

SCALES = np.array([1.0, 1.0, 1.0, 1.0, 2e-3, 3e-3, 5e-4, 5e-4, 5e-3])
"""Scales of the deviations of a lens' numbers: each moves a corner at a picture's edge by about a pixel."""


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera's intrinsics: focal lengths, principal point, and distortion of the lens.

    Attributes:
        values: The lens' numbers in the order of `LENS_NAMES` ``(9,)``.
        size: Width and height of the camera's pictures, px.
        name: Name of the camera in messages.
    """

    values: Array
    size: tuple[int, int]
    name: str = "camera"


def projected(values: Array, points: Array) -> Array:
    """Compute the pixels ``(..., 2)`` of points in the camera's frame.

    Args:
        values: The lens' numbers ``(9,)``, in the order of `LENS_NAMES`.
        points: Points ``(..., 3)``, m; z is along the view.
    """
    fx, fy, cx, cy = values[:4]
    x, y = np.moveaxis(distorted(values, points[..., :2] / points[..., 2:]), -1, 0)
    return np.stack([fx * x + cx, fy * y + cy], axis=-1)


def distorted(values: Array, ideal: Array) -> Array:
    """Return the slopes ``(..., 2)`` of rays after the lens' distortion.

    Args:
        values: The lens' numbers ``(9,)``, in the order of `LENS_NAMES`.
        ideal: Slopes x / z and y / z of the rays without distortion ``(..., 2)``.
    """
    k1, k2, p1, p2, k3 = values[4:]
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    along = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    down = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.stack([along, down], axis=-1)


def undistorted(values: Array, pixels: Array) -> Array:
    """Return the slopes x / z and y / z of the rays that the lens maps to pixels, before its distortion ``(..., 2)``.

    The distortion is inverted by 30 steps of fixed-point iteration.

    Args:
        values: The lens' numbers ``(9,)``, in the order of `LENS_NAMES`.
        pixels: Pixels ``(..., 2)``.
    """
    slopes = (pixels - values[2:4]) / values[:2]
    ideal = slopes
    for _ in range(30):
        ideal = ideal + slopes - distorted(values, ideal)
    return np.asarray(ideal)


def by_point(values: Array, points: Array) -> Array:
    """Compute the derivative of the pixels (`projected`) with respect to the points ``(..., 2, 3)``, px per m.

    The arguments are those of `projected`.
    """
    z = points[..., 2]
    x, y = points[..., 0] / z, points[..., 1] / z
    k1, k2, p1, p2, k3 = values[4:]
    r2 = x * x + y * y
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    by_ray = np.empty((*x.shape, 2, 2))
    by_ray[..., 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_ray[..., 0, 1] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    by_ray[..., 1, 0] = by_ray[..., 0, 1]
    by_ray[..., 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    ray = np.zeros((*x.shape, 2, 3))
    ray[..., 0, 0] = ray[..., 1, 1] = 1.0 / z
    ray[..., 0, 2], ray[..., 1, 2] = -x / z, -y / z
    return np.asarray(values[:2, None] * (by_ray @ ray))


def by_values(values: Array, points: Array) -> Array:
    """Compute the derivative of the pixels (`projected`) with respect to the lens' numbers ``(..., 2, 9)``.

    The arguments are those of `projected`.
    """
    fx, fy = values[:2]
    ideal = points[..., :2] / points[..., 2:]
    bent = distorted(values, ideal)
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    derivatives = np.zeros((*x.shape, 2, len(LENS_NAMES)))
    derivatives[..., 0, 0], derivatives[..., 1, 1] = bent[..., 0], bent[..., 1]
    derivatives[..., 0, 2] = derivatives[..., 1, 3] = 1.0
    for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
        derivatives[..., 0, column], derivatives[..., 1, column] = fx * x * power, fy * y * power
    derivatives[..., 0, 6], derivatives[..., 1, 6] = fx * 2.0 * x * y, fy * (r2 + 2.0 * y * y)
    derivatives[..., 0, 7], derivatives[..., 1, 7] = fx * (r2 + 2.0 * x * x), fy * 2.0 * x * y
    return derivatives


SLANT = 0.5
"""Cosine of 60 deg, the largest angle between line of sight and board's normal at which corners are detected."""

Mount = Literal["hand", "world"]
"""Place of the camera: "hand" on the arm's tool, or "world" fixed in the world, with the board on the tool."""


@register("observation", "pixels")
@dataclass(frozen=True, eq=False)
class PixelObservations(Observations):
    """V views of a board with K corners, or of any K points at fixed places on one target.

    Attributes:
        joints: Joints ``(V, n)``, rad or m.
        corners: Pixel at which each corner was found ``(V, K, 2)``, px; values of corners not found are ignored.
        seen: Whether each corner was found ``(V, K)``.
        board: Positions of the corners or points ``(K, 3)``, m, in the frame of the board or target.
        camera: The lens; numbers that are fitted start at its values.
        lens_std: Standard uncertainty of each of the lens' numbers ``(9,)``: 0 if it is exact, infinite if it is
            unknown.
        std: Standard uncertainty of a corner's coordinate ``(V, K)``, px.
        mount: "hand" for a camera on the arm's tool, "world" for one fixed in the world with the board on the tool.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: Picture or file and line of each view; None if the views come from no file.
        remarks: Why a view shows no corner ``(V,)``, empty if it shows some; None if no reasons are known.
        pictures: Path of each view's picture ``(V,)``; None if corners came without pictures.
    """

    joints: Array
    corners: Array
    seen: NDArray[np.bool_]
    board: Array
    camera: Lens
    lens_std: Array
    std: Array
    mount: Mount = "hand"
    conditions: Conditions = field(default_factory=Conditions)
    source: str = "pictures"
    kind: str = "pixels"
    framed: bool = True
    origins: Origins | None = None
    remarks: NDArray[np.str_] | None = None
    pictures: NDArray[np.str_] | None = None
    per_row = ("corners", "seen", "std", "remarks", "pictures")
    width = 2
    rounding = 0.03

    @cached_property
    def numbers(self) -> Stated:
        """The numbers of the lens, with their stated values and uncertainties."""
        return Stated(LENS_NAMES, self.camera.values, self.lens_std, SCALES)

    @property
    def views(self) -> PixelObservations:
        """The rows as `PixelObservations`, which are this data set itself."""
        return self

    @property
    def rows_of_misses(self) -> Rows:
        """Index, from 0, of each miss's view ``(R,)``; there is one miss per corner found."""
        return np.nonzero(self.seen)[0]

    def imagined(self, joints: Array) -> Self:
        """Return views of the same camera at other joints ``(M, n)``, as if every corner were seen (see `visible`)."""
        usual = np.full_like(self.std, np.median(self.std[self.seen]))
        full_views = replace(self, seen=np.ones_like(self.seen), std=usual, remarks=None, pictures=None)
        return Observations.imagined(full_views, joints)

    def starters(self) -> NDArray[np.bool_]:
        """Return a mask ``(V,)`` of views that show the board's pose: `STARTING` points or more, not near one line."""
        enough: NDArray[np.bool_] = self.seen.sum(axis=1) >= STARTING
        for row in np.flatnonzero(enough):
            places = self.corners[row][self.seen[row]]
            along, across = np.linalg.svd(places - places.mean(axis=0))[1]
            enough[row] = across >= LEAST_SPREAD * along
        return enough

    def rough_poses(self, prismatic: tuple[bool, ...]) -> Measurements:
        """Return the pose of the board in the camera's frame, from each view that determines the pose (`starters`).

        If the camera is on the tool, return the pose of the camera in the board's frame instead.

        Args:
            prismatic: Whether each joint is prismatic.

        Raises:
            InputError: If no view determines the board's pose.
        """
        views = self.select(self.starters())
        if not len(views.joints):
            raise InputError(
                f"{self.source}: none of {len(self.joints)} views shows {STARTING} points that are not near one line, "
                "to start from; give views that do"
            )
        poses = board_poses(views)
        poses = inverse_pose(poses) if self.mount == "hand" else poses
        seen = views.joints, poses.position, poses.rotation, prismatic
        return Measurements(*seen, source=self.source, conditions=views.conditions)

    def visible(self, model: ArmModel, unknowns: Array, margin: float = 0.0) -> NDArray[np.bool_]:
        """Return a mask ``(V, K)`` of the corners whose predicted pixels are inside the picture.

        A flat board must face the camera; other points are seen from all sides.

        Args:
            model: The arm.
            unknowns: Values of the lens' fitted numbers.
            margin: Least distance of a corner from the picture's edge, px.
        """
        tool, points = model.pose(self.joints, self.conditions), self.in_camera(model)
        values, ahead = self.numbers.whole(unknowns), points[..., 2] > 0.0
        if not self.board[:, 2].any():
            towards = tool.rotation[..., 2] if self.mount == "world" else tool.rotation[:, 2]  # into the board
            middle = points.mean(axis=1)
            facing = np.sum(towards * middle, axis=1) > SLANT * np.linalg.norm(middle, axis=1)
            ahead = ahead & facing[:, None]
        points = np.where(ahead[..., None], points, [0.0, 0.0, 1.0])
        size = np.array(self.camera.size)
        pinhole = points[..., :2] / points[..., 2:] * values[:2] + values[2:4]
        near = (np.abs(pinhole - size / 2.0) < size).all(axis=-1)  # farther off the distortion means nothing
        places = projected(values, points)
        return np.asarray(ahead & near & ((places >= margin) & (places <= size - 1.0 - margin)).all(axis=-1))

    def in_camera(self, model: ArmModel) -> Array:
        """Return the board's corners in the camera's frame ``(V, K, 3)``, m."""
        tool = model.pose(self.joints, self.conditions)
        if self.mount == "world":
            return np.asarray(tool.position[:, None] + self.board @ np.swapaxes(tool.rotation, 1, 2))
        return np.asarray((self.board - tool.position[:, None]) @ tool.rotation)

    def pixel_errors(self, model: ArmModel, unknowns: Array) -> Array:
        """Return measured minus predicted pixels ``(R, 2)`` of the corners that were found, view by view.

        Args:
            model: The arm.
            unknowns: Values of the lens' fitted numbers.
        """
        return self._errors(model, self.numbers.whole(unknowns))

    def _errors(self, model: ArmModel, values: Array) -> Array:
        """Return `pixel_errors`, given all of the lens' numbers ``(9,)``."""
        return np.asarray((self.corners - projected(values, self.in_camera(model)))[self.seen])

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Return the pixel errors of the corners found, as lengths at the corners' distance ``(R, 2)``, m."""
        return np.asarray(self._errors(model, numbers) * self.in_camera(model)[self.seen][:, 2:] / numbers[:2])

    def whitened(self, model: ArmModel, numbers: Array) -> Array:
        """Return the pixel errors ``(R, 2)``, in standard uncertainties."""
        return self._errors(model, numbers) / self.std[self.seen][:, None]

    def readings(self) -> Array:
        """Return the corners' pixels ``(V, 2 K)``, 0 for corners not found; they serve only to compare rows."""
        return np.where(self.seen[..., None], self.corners, 0.0).reshape(len(self.joints), -1)

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Return whitened derivatives of the pixels of the R corners found.

        Returns:
            Derivatives with respect to the arm's parameters ``(R, 2, P)`` and to the lens' numbers ``(R, 2, 9)``.
        """
        tool, pose = model.pose(self.joints, self.conditions), model.jacobian(self.joints, self.conditions)
        rows, _ = np.nonzero(self.seen)
        points = self.in_camera(model)[self.seen]
        if self.mount == "world":
            lever = points - tool.position[rows]
            by_arm = point_jacobian(pose[rows], lever)
        else:
            lever = np.broadcast_to(self.board, (*self.corners.shape[:2], 3))[self.seen] - tool.position[rows]
            by_arm = -np.swapaxes(tool.rotation, 1, 2)[rows] @ point_jacobian(pose[rows], lever)
        weight = 1.0 / self.std[self.seen][:, None, None]
        return by_point(numbers, points) @ by_arm * weight, by_values(numbers, points) * weight


# Where a board or other points stand in a camera's frame, view by view. A first pose to start from, not a result: the
# fit of the arm takes the corners themselves.

STARTING = 4
"""Least number of points that determine the board's pose in one view; with three there may be up to four solutions."""

LEAST_SPREAD = 0.05
"""Least spread of a view's corners across the line that fits them best, as a share of the spread along it."""

TRIED, STEPS = 4, 12
"""Number of starting poses that are refined, out of 24 (the rotations of a cube), and number of refinement steps."""


def board_poses(data: PixelObservations) -> Pose:
    """Return the board's pose in the camera's frame in each view ``(V,)``, fitted to the viewing rays of its points.

    The board starts in each of the 24 rotations of a cube. Its position then minimises the squared distances between
    points and rays. Gauss-Newton steps refine the best `TRIED` of these starts.

    Args:
        data: Views with at least four corners each, not all in one line.
    """
    points, seen, middle = data.board, data.seen, data.board.mean(axis=0)
    rays = undistorted(data.camera.values, np.where(seen[..., None], data.corners, data.camera.values[2:4]))
    sight = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)[:, None]
    sight, weight = sight / np.linalg.norm(sight, axis=-1, keepdims=True), seen[:, None, :, None]

    def missed(turn: Array, place: Array) -> tuple[Array, Array, Array, Array]:
        lever = (points - middle) @ np.swapaxes(turn, -1, -2)
        there = lever + place[..., None, :]
        far = np.linalg.norm(there, axis=-1, keepdims=True)
        return lever, far, there / far, weight * (sight - there / far)

    turn = np.repeat(Rotation.create_group("O").as_matrix()[None], len(seen), axis=0)
    lever = (points - middle) @ np.swapaxes(turn, -1, -2)
    across = weight[..., None] * (np.eye(3) - sight[..., None] * sight[..., None, :])
    place = -np.linalg.solve(across.sum(axis=2), (across @ lever[..., None]).sum(axis=2))[..., 0]

    def nearest(turn: Array, place: Array, count: int) -> tuple[Array, Array]:
        best = np.argsort(np.sum(missed(turn, place)[3] ** 2, axis=(2, 3)), axis=1)[:, :count]
        return np.take_along_axis(turn, best[..., None, None], 1), np.take_along_axis(place, best[..., None], 1)

    turn, place = nearest(turn, place, TRIED)
    for _ in range(STEPS):
        lever, far, ahead, errors = missed(turn, place)
        slope = weight[..., None] * (np.eye(3) - ahead[..., None] * ahead[..., None, :]) / far[..., None]
        slope = (slope @ point_jacobian(np.eye(6), lever)).reshape(*turn.shape[:2], -1, 6)
        back = np.swapaxes(slope, -1, -2)
        step = np.linalg.solve(back @ slope + 1e-12 * np.eye(6), back @ errors.reshape(*slope.shape[:3], 1))[..., 0]
        turn, place = rotation_matrix(step[..., 3:]) @ turn, place + step[..., :3]
    turn, place = (part[:, 0] for part in nearest(turn, place, 1))
    return Pose(place - turn @ middle, turn)
