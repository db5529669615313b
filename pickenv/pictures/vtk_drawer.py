"""Draws stages with VTK, off screen: lit, with smooth edges, on a graphics adapter or on the processor.

VTK gets surfaces that stay the same between pictures once. All moving bodies are passed to it as one set of opaque and
one set of transparent triangles, which costs less than moving many bodies one by one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vtkmodules import vtkRenderingOpenGL2
from vtkmodules.util import numpy_support
from vtkmodules.vtkCommonCore import vtkPoints, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkLight, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow

from pickenv.pictures.solids import all_triangles, mesh_triangles, rod_triangles
from pickenv.pictures.stage import Eye, Mesh, Pixels, Stage, backdrop

_NUMPY: Any = numpy_support  # it carries no annotations
MOST_KEPT = 16
"""Largest number of surfaces that are kept for later pictures."""


class VtkDrawer:
    """A VTK window without a screen, with its lights and the bodies that it shows.

    Args:
        size: Width and height of its pictures, px.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.renderer: Any = vtkRenderer()
        # It needs no screen: EGL's on Linux, which draws on the processor where there is no adapter.
        self.window: Any = getattr(vtkRenderingOpenGL2, "vtkEGLRenderWindow", vtkRenderWindow)()
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(0)
        self.window.SetSize(*size)
        self.window.AddRenderer(self.renderer)
        self.renderer.UseFXAAOn()  # smooth edges, at a third of the cost of several samples for each pixel
        self.renderer.GradientBackgroundOn()
        self.renderer.AutomaticLightCreationOff()
        for place, strength in (((-0.6, 0.9, 1.0), 0.85), ((0.8, 0.2, 1.0), 0.4), ((0.0, -0.5, 1.0), 0.35)):
            light: Any = vtkLight()
            light.SetLightTypeToCameraLight()
            light.SetPosition(*place)
            light.SetIntensity(strength)
            self.renderer.AddLight(light)
        self.solid, self.clear = _Body(opaque=True), _Body(opaque=False)
        for body in (self.solid, self.clear):
            self.renderer.AddActor(body.actor)
        self.kept: dict[int, tuple[Mesh, _Body]] = {}

    def draw(self, stage: Stage) -> Pixels:
        """Draw a stage without its words and dial: ``(height, width, 3)``."""
        self._keep(stage.still)
        parts = [rod_triangles(rods) for rods in (*stage.rods, *stage.balls) if len(rods.start)]
        parts += [mesh_triangles(mesh) for mesh in stage.meshes]
        for body, opaque in ((self.solid, True), (self.clear, False)):
            body.show(all_triangles([_some(part, opaque) for part in parts]))
        upper, lower = backdrop(stage.dark)
        self.renderer.SetBackground(*(value / 255 for value in lower))
        self.renderer.SetBackground2(*(value / 255 for value in upper))
        camera = self.renderer.GetActiveCamera()
        camera.SetPosition(*stage.eye.position)
        camera.SetFocalPoint(*stage.eye.target)
        camera.SetViewUp(0.0, 0.0, 1.0)
        camera.SetViewAngle(stage.eye.angle_deg)
        self.renderer.ResetCameraClippingRange()
        self.window.Render()
        pixels: Any = vtkUnsignedCharArray()
        self.window.GetPixelData(0, 0, self.size[0] - 1, self.size[1] - 1, 0, pixels, 0)
        flat: NDArray[np.uint8] = _NUMPY.vtk_to_numpy(pixels)
        return flat.reshape(self.size[1], self.size[0], 3)[::-1].copy()

    def _keep(self, still: tuple[Mesh, ...]) -> None:
        """Show the given still surfaces, hide all others, and drop some of the hidden ones where too many are kept."""
        for _, body in self.kept.values():
            body.actor.VisibilityOff()
        for surface in still:
            if id(surface) not in self.kept:
                body = _Body(opaque=True)
                body.show(mesh_triangles(surface))
                self.renderer.AddActor(body.actor)
                self.kept[id(surface)] = surface, body
            self.kept[id(surface)][1].actor.VisibilityOn()
        visible = {id(surface) for surface in still}
        for key in [key for key in self.kept if key not in visible][: max(len(self.kept) - MOST_KEPT, 0)]:
            self.renderer.RemoveActor(self.kept.pop(key)[1].actor)


class _Body:
    """One set of triangles in a window."""

    def __init__(self, *, opaque: bool) -> None:
        self.data: Any = vtkPolyData()
        self.mapper: Any = vtkPolyDataMapper()
        self.actor: Any = vtkActor()
        self.mapper.SetInputData(self.data)
        self.mapper.SetColorModeToDirectScalars()
        self.actor.SetMapper(self.mapper)
        look = self.actor.GetProperty()
        look.SetAmbient(0.3)
        look.SetDiffuse(0.8)
        look.SetSpecular(0.18)
        look.SetSpecularPower(24.0)
        (self.actor.ForceOpaqueOn if opaque else self.actor.ForceTranslucentOn)()
        if not opaque:
            look.BackfaceCullingOn()

    def show(self, triangles: Mesh) -> None:
        """Replace the body's triangles by these."""
        corners, normals = (
            _NUMPY.numpy_to_vtk(np.ascontiguousarray(vectors, np.float32), deep=1)
            for vectors in (triangles.corners, triangles.normals)
        )
        count = len(triangles.triangles)
        ends, numbers = np.arange(0, 3 * count + 1, 3, dtype=np.int64), triangles.triangles.astype(np.int64).ravel()
        points: Any = vtkPoints()
        cells: Any = vtkCellArray()
        points.SetData(corners)
        cells.SetData(*(_NUMPY.numpy_to_vtkIdTypeArray(values, deep=1) for values in (ends, numbers)))
        self.data.SetPoints(points)
        self.data.SetPolys(cells)
        self.data.GetPointData().SetNormals(normals)
        self.data.GetPointData().SetScalars(_NUMPY.numpy_to_vtk(np.ascontiguousarray(triangles.colour), deep=1))
        self.data.Modified()
        self.actor.SetVisibility(count > 0)


def _some(part: Mesh, opaque: bool) -> Mesh:
    """The opaque triangles of a set where ``opaque`` is true, else its transparent ones."""
    mask = (part.colour[part.triangles[:, 0], 3] == 255) == opaque
    return part if mask.all() else replace(part, triangles=part.triangles[mask])


if __name__ == "__main__":  # try it out: where VTK cannot draw, it ends the program
    VtkDrawer((16, 16)).draw(Stage(Eye(np.ones(3), np.zeros(3)), size=(16, 16)))
