"""Draws stages with MuJoCo's renderer, off screen: lit, with smooth edges, on a graphics adapter or on the processor.

Rods and balls are shapes of MuJoCo's own. All surfaces together are the faces of one soft body, which are replaced for
each picture; a texture with all colours, as a palette, gives each face its own. A plane behind all is the background.
"""

from __future__ import annotations

import atexit
import os
import sys
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.pictures.solids import all_triangles, mesh_triangles
from pickenv.pictures.stage import Mesh, Pixels, Rods, Stage, backdrop

NEAR, FAR = 0.02, 100.0
"""Distances from the eye between which bodies are seen, m."""
LIGHTS = (((-0.6, 0.9, 1.0), 0.85), ((0.8, 0.2, 1.0), 0.4), ((0.0, -0.5, 1.0), 0.35))
"""Direction to each light (to the right, up, and back from the eye), and its strength."""
AMBIENT, DIFFUSE, SPECULAR, SHININESS = 0.3, 0.8, 0.18, 24 / 128
LEVELS, PALETTE = 64, 512
"""Levels of each primary colour in the palette, and the palette's width and height, px."""
FACES = 8
"""Faces for which MuJoCo keeps room with each triangle of a soft body."""


class MujocoDrawer:
    """MuJoCo's renderer without a screen, with room for so many faces and shapes, and lights that go with the eye."""

    def __init__(self) -> None:
        if sys.platform == "linux" and "MUJOCO_GL" not in os.environ:  # MuJoCo itself would ask for a screen
            from mujoco.egl import GLContext
        else:
            GLContext = mujoco.GLContext
        self.gl: Any = GLContext(0, 0)
        self.room = np.zeros(4, dtype=int)
        self.scene: Any = None
        self.context: Any = None
        atexit.register(self.gl.free)

    def draw(self, stage: Stage) -> Pixels:
        """Draw a stage without its words and dial: ``(height, width, 3)``."""
        self.gl.make_current()
        surfaces = all_triangles([_still_triangles(stage.still), *map(mesh_triangles, stage.meshes)])
        groups = (*stage.rods, *stage.balls)
        needed = np.array([*stage.size, len(surfaces.triangles), 2 + sum(len(rods.start) for rods in groups)])
        if np.any(needed > self.room):
            self._make_room(np.maximum(self.room, 2 * needed))
        self.scene.ngeom = 0
        for rods in groups:
            self._add_rods(rods)
        self._add_surfaces(surfaces, stage.eye.position)
        self._look(stage)
        pixels, view = np.empty((*stage.size[::-1], 3), dtype=np.uint8), mujoco.MjrRect(0, 0, *stage.size)
        mujoco.mjr_render(view, self.scene, self.context)
        mujoco.mjr_readPixels(pixels, None, view, self.context)
        return pixels[::-1].copy()

    def _make_room(self, room: Array) -> None:
        """Make room for a width and height, px, and for numbers of faces and of shapes."""
        model = mujoco.MjModel.from_xml_string(_model(*room[:3]))
        shades = np.linspace(0, 255, LEVELS).round()
        palette = np.stack(np.meshgrid(shades, shades, shades, indexing="ij"), axis=-1)
        ramps = np.repeat([backdrop(dark) for dark in (False, True)], 2, axis=1)
        model.tex_data[:] = np.concatenate([palette.ravel(), ramps.ravel()])
        self.context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.context)
        self.scene, self.room = mujoco.MjvScene(model, maxgeom=int(room[3])), room
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self.scene.nlight = len(LIGHTS)
        for number, (_, strength) in enumerate(LIGHTS):
            light = self.scene.lights[number]
            light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
            light.ambient, light.diffuse, light.specular = np.repeat(
                [[AMBIENT / len(LIGHTS)], [DIFFUSE * strength], [strength]], 3, axis=1
            )

    def _add(self, shape: Any, size: ArrayLike, place: Array, colour: Array, turn: Array = np.eye(3)) -> Any:
        geom = self.scene.geoms[self.scene.ngeom]
        self.scene.ngeom += 1
        mujoco.mjv_initGeom(geom, shape, np.asarray(size), place, turn.ravel(), np.float32(colour))
        geom.specular, geom.shininess = SPECULAR, SHININESS
        return geom

    def _add_rods(self, rods: Rods) -> None:
        colours = rods.colour / 255
        colours[:, 3] = 1.0 - np.sqrt(1.0 - colours[:, 3])  # MuJoCo draws each transparent shape twice
        for start, end, radius, colour in zip(rods.start, rods.end, rods.radius, colours, strict=True):
            geom = self._add(mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), start, colour)
            if np.linalg.norm(end - start) > 1e-9:
                mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)

    def _add_surfaces(self, surfaces: Mesh, eye: Array) -> None:
        corners, normals = surfaces.corners[surfaces.triangles], surfaces.normals[surfaces.triangles]
        outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        away = np.sum(outwards * (corners[:, 0] - eye), axis=1) > 0.0  # both sides of a surface are seen
        corners[away], normals[away] = corners[away, ::-1], -normals[away, ::-1]
        levels = np.rint(surfaces.colour[surfaces.triangles[:, 0], :3] * ((LEVELS - 1) / 255))
        row, column = np.divmod(levels @ [LEVELS**2, LEVELS, 1], PALETTE)
        places = np.repeat((np.stack([column, row], axis=1) + 0.5) / PALETTE, 3, axis=0)
        self.scene.flexface[: corners.size] = corners.ravel()
        self.scene.flexnormal[: normals.size] = normals.ravel()
        self.scene.flextexcoord[: places.size] = places.ravel()
        self.scene.flexfaceused[0] = len(corners)
        geom = self._add(mujoco.mjtGeom.mjGEOM_FLEX, np.zeros(3), np.zeros(3), np.ones(4))
        geom.objid, geom.matid, geom.texcoord = 0, 0, 1

    def _look(self, stage: Stage) -> None:
        """Place the eye, its lights, and the background, twice as large as the picture: its ramp is the middle half."""
        position, (right, up, ahead) = stage.eye.position, stage.eye.axes()
        slope = np.tan(np.radians(stage.eye.angle_deg) / 2)
        for camera in self.scene.camera:
            camera.pos, camera.forward, camera.up = position, ahead, up
            camera.frustum_near, camera.frustum_far = NEAR, FAR
            camera.frustum_bottom, camera.frustum_top = -NEAR * slope, NEAR * slope
        axes = np.array([right, up, -ahead])
        for number, (place, _) in enumerate(LIGHTS):
            self.scene.lights[number].dir = -np.array(place) @ axes
        size = FAR * slope * np.array([stage.size[0] / stage.size[1], 1.0, 1.0])
        plane = self._add(mujoco.mjtGeom.mjGEOM_PLANE, 1.8 * size, position + 0.9 * FAR * ahead, np.ones(4), axes.T)
        plane.matid, plane.emission = 2 if stage.dark else 1, 1.0


@lru_cache(maxsize=16)
def _still_triangles(still: tuple[Mesh, ...]) -> Mesh:
    return all_triangles([mesh_triangles(surface) for surface in still])


def _model(width: int, height: int, faces: int) -> str:
    """A model with the palette, the ramps of both backgrounds, and a soft body with room for ``faces``."""
    number = faces // FACES + 1
    sides = {"palette": PALETTE, "light": 2, "dark": 2}
    textures = (f'<texture name="{k}" type="2d" builtin="flat" width="{n}" height="{n}"/>' for k, n in sides.items())
    materials = (f'<material name="{name}" texture="{name}"/>' for name in sides)
    return f"""<mujoco>
        <visual>
            <global offwidth="{width}" offheight="{height}"/>
            <quality offsamples="4" numslices="20" numstacks="10"/>
        </visual>
        <asset>{"".join([*textures, *materials])}</asset>
        <deformable>
            <flex name="surfaces" dim="2" body="world" material="palette"
                vertex="{" ".join(f"{i} 0 0 {i} 1 0 {i} 0 1" for i in range(number))}"
                element="{" ".join(map(str, range(3 * number)))}"/>
        </deformable>
    </mujoco>"""
