"""Draw stages (contents of pictures) with MuJoCo's renderer, off screen, on a GPU or a CPU.

Rods and balls are MuJoCo's own shapes. All meshes, which are opaque, become the faces of one soft body (flex). The
faces are replaced for each picture, and a texture has one pixel with the colour of each face. The background is a plane
behind everything.
"""

from __future__ import annotations

import atexit
import os
import sys
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from pickenv.arm import Array
from pickenv.pictures.shapes import all_triangles, mesh_triangles
from pickenv.pictures.stage import SIZE, Eye, Mesh, Pixels, Rods, Stage, backdrop

NEAR, FAR = 0.02, 100.0
LIGHTS = (((-0.6, 0.9, 1.0), 0.85), ((0.8, 0.2, 1.0), 0.4), ((0.0, -0.5, 1.0), 0.35))
AMBIENT, DIFFUSE, SPECULAR, SHININESS = 0.3, 0.8, 0.18, 24 / 128


def screenless(width: int, height: int) -> Any:
    """Make an OpenGL context that needs no screen, for pictures of a width and height in px."""
    if sys.platform == "linux" and "MUJOCO_GL" not in os.environ:  # where MuJoCo itself would ask for a screen
        from mujoco.egl import GLContext
    else:
        GLContext = mujoco.GLContext
    context = GLContext(width, height)
    atexit.register(context.free)  # before MuJoCo ends EGL
    return context


def context_of(model: Any) -> Any:
    """Make the `mujoco.MjrContext` with which MuJoCo draws a model off screen."""
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    return context


def pixels_of(scene: Any, context: Any, size: tuple[int, int]) -> Pixels:
    """Render a scene as RGB pixels ``(height, width, 3)``; ``size`` is width and height, px."""
    pixels, view = np.empty((*size[::-1], 3), dtype=np.uint8), mujoco.MjrRect(0, 0, *size)
    mujoco.mjr_render(view, scene, context)
    mujoco.mjr_readPixels(pixels, None, view, context)
    return pixels[::-1].copy()


class ModelPictures:
    """Renderer for a MuJoCo model's own cameras, without shadows.

    Args:
        model: `mujoco.MjModel`.
        size: Width and height of the pictures, px.
    """

    def __init__(self, model: Any, size: tuple[int, int]) -> None:
        self.model, self.size, self.gl = model, size, screenless(*size)
        self.gl.make_current()
        self.context = context_of(model)
        self.scene, self.camera = mujoco.MjvScene(model, maxgeom=model.ngeom + 100), mujoco.MjvCamera()
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self.scene.flags[flag] = False

    def draw(self, data: Any, camera: int, option: Any, dark: bool = False) -> Pixels:
        """Render the picture of a camera ``(height, width, 3)``.

        Args:
            data: `mujoco.MjData`.
            camera: Index of the camera in the model, from 0.
            option: `mujoco.MjvOption`, which says which groups of bodies are shown.
            dark: Whether the background is black instead of a sky.
        """
        self.gl.make_current()
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = not dark
        self.camera.type, self.camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, camera
        mujoco.mjv_updateScene(self.model, data, option, None, self.camera, mujoco.mjtCatBit.mjCAT_ALL, self.scene)
        return pixels_of(self.scene, self.context, self.size)

    def close(self) -> None:
        """Free the OpenGL context."""
        atexit.unregister(self.gl.free)
        self.gl.make_current()
        self.context.free()
        self.gl.free()


class MujocoDrawer:
    """Off-screen renderer for stages; its buffers for pixels, faces and shapes grow as needed."""

    def __init__(self) -> None:
        self.gl = screenless(*SIZE)
        self.room = np.zeros(4, dtype=int)

    def draw(self, stage: Stage) -> Pixels:
        """Draw a stage without its words and dial, as RGB pixels ``(height, width, 3)``."""
        self.gl.make_current()
        surfaces = all_triangles([_still_triangles(stage.still), *map(mesh_triangles, stage.meshes)])
        groups = (*stage.rods, *stage.balls)
        needed = np.array([*stage.size, len(surfaces.triangles), 2 + sum(len(rods.start) for rods in groups)])
        if np.any(needed > self.room):
            self._make_room(np.maximum(self.room, [1, 1, 2, 2] * needed))
        self.scene.ngeom = 0
        for rods in groups:
            self._add_rods(rods)
        self._add_surfaces(surfaces, stage.eye.position)
        self._look(stage.eye, stage.size[0] / stage.size[1])
        colours = surfaces.colour[surfaces.triangles[:, 0], :3]
        self.model.tex_data[: colours.size] = colours.ravel()
        self.model.tex_data[-12:] = np.repeat(backdrop(stage.dark), 2, axis=0).ravel()
        for texture in range(2):
            mujoco.mjr_uploadTexture(self.model, self.context, texture)
        return pixels_of(self.scene, self.context, stage.size)

    def _make_room(self, room: Array) -> None:
        """Allocate buffers for four sizes ``room``: picture width and height, px, count of faces, count of shapes."""
        self.room, side = room, int(np.ceil(np.sqrt(room[2] + 1)))
        self.model = mujoco.MjModel.from_xml_string(_model(side, *room[:3]))
        self.context = context_of(self.model)
        self.scene = mujoco.MjvScene(self.model, maxgeom=int(room[3]))
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self.scene.nlight = len(LIGHTS)
        rows, columns = np.divmod(np.arange(len(self.scene.flextexcoord) // 6), side)
        self.scene.flextexcoord[:] = np.repeat((np.column_stack([columns, rows]) + 0.5) / side, 3, axis=0).ravel()

    def _add(self, kind: Any, size: Array, place: Array, turn: Array, colour: Array) -> Any:
        """Add a shape of a `mujoco.mjtGeom` kind to the scene, and return it.

        `mujoco.mjv_initGeom` explains ``size``, ``place`` (position, m), ``turn`` (rotation matrix) and ``colour``.
        """
        shape = self.scene.geoms[self.scene.ngeom]
        self.scene.ngeom += 1
        mujoco.mjv_initGeom(shape, kind, size, place, turn.ravel(), colour.astype(np.float32))
        shape.specular, shape.shininess = SPECULAR, SHININESS
        return shape

    def _add_rods(self, rods: Rods) -> None:
        colours = rods.colour / 255
        colours[:, 3] = 1.0 - np.sqrt(1.0 - colours[:, 3])  # MuJoCo draws each transparent shape twice
        for start, end, radius, colour in zip(rods.start, rods.end, rods.radius, colours, strict=True):
            shape = self._add(mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), start, np.eye(3), colour)
            if np.linalg.norm(end - start) > 1e-9:
                mujoco.mjv_connector(shape, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)

    def _add_surfaces(self, surfaces: Mesh, eye: Array) -> None:
        corners, normals = surfaces.corners[surfaces.triangles], surfaces.normals[surfaces.triangles]
        outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        away = np.sum(outwards * (corners[:, 0] - eye), axis=1) > 0.0  # turned over, as both sides are seen
        corners[away], normals[away] = corners[away, ::-1], -normals[away, ::-1]
        self.scene.flexface[: corners.size] = corners.ravel()
        self.scene.flexnormal[: normals.size] = normals.ravel()
        self.scene.flexfaceused[0] = len(corners)
        shape = self._add(mujoco.mjtGeom.mjGEOM_FLEX, np.zeros(3), np.zeros(3), np.eye(3), np.ones(4))
        shape.objid, shape.matid, shape.texcoord = 0, 0, 1

    def _look(self, eye: Eye, aspect: float) -> None:
        """Set the camera, the lights that move with it, and the background plane, whose middle half is visible.

        ``aspect`` is the width of the picture over its height. Bodies are visible at distances from `NEAR` to `FAR`, m,
        from the viewpoint. `LIGHTS` has the direction to each light (components to the right, up, and from the scene to
        the viewer), and its strength.
        """
        right, up, ahead = eye.axes()
        axes, slope = np.array([right, up, -ahead]), np.tan(np.radians(eye.angle_deg) / 2)
        for camera in self.scene.camera:
            camera.pos, camera.forward, camera.up = eye.position, ahead, up
            camera.frustum_bottom, camera.frustum_top = -NEAR * slope, NEAR * slope
            camera.frustum_near, camera.frustum_far = NEAR, FAR
        for light, (place, strength) in zip(self.scene.lights, LIGHTS, strict=False):
            light.type, light.dir = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, -np.array(place) @ axes
            light.ambient, light.diffuse = np.full(3, AMBIENT / len(LIGHTS)), np.full(3, DIFFUSE * strength)
            light.specular = np.full(3, strength)
        size = 1.8 * FAR * slope * np.array([aspect, 1.0, 1.0])
        plane = self._add(mujoco.mjtGeom.mjGEOM_PLANE, size, eye.position + 0.9 * FAR * ahead, axes.T, np.ones(4))
        plane.matid, plane.emission = 1, 1.0


@lru_cache(maxsize=16)
def _still_triangles(still: tuple[Mesh, ...]) -> Mesh:
    return all_triangles([mesh_triangles(surface) for surface in still])


def _model(side: int, width: int, height: int, faces: int) -> str:
    """Return the MJCF text of a model whose textures and soft body have room for ``faces`` triangles.

    Args:
        side: Width and height of the texture with the faces' colours, px.
        width: Width of pictures, px.
        height: Height of pictures, px.
        faces: Number of triangles.
    """
    count = faces // 8 + 1
    return f"""<mujoco>
        <visual><global offwidth="{width}" offheight="{height}"/><quality numslices="16" numstacks="8"/></visual>
        <asset>
            <texture name="faces" type="2d" builtin="flat" width="{side}" height="{side}"/>
            <texture name="ramp" type="2d" builtin="flat" width="2" height="2"/>
            <material name="faces" texture="faces"/><material name="ramp" texture="ramp"/>
        </asset>
        <deformable>
            <flex name="faces" dim="2" body="world" material="faces" element="{" ".join(map(str, range(3 * count)))}"
                vertex="{" ".join(f"{i} 0 0 {i} 1 0 {i} 0 1" for i in range(count))}"/>
        </deformable></mujoco>"""


if __name__ == "__main__":  # try it out, in a process of its own
    MujocoDrawer().draw(Stage(Eye(np.ones(3), np.zeros(3)), size=(16, 16)))
