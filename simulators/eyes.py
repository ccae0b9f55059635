"""What the two cameras of the cell see at a moment: the world's things, composed for the renderer."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators import parts
from simulators.gige import Exposure
from simulators.place import Place
from simulators.render import Optics, Scene, Shape, placed, render
from simulators.things import Battery
from simulators.wear import LIGHT_OFF
from simulators.world import World

CEILING_LEVEL = 20.0
NOMINAL_EXPOSURE_US = 2000.0
NEAR_MM = 60.0  # a thing further from a camera's axis than its own size and this is not drawn


class Eye:
    """One camera's view of the world: called by its protocol simulator for every exposure."""

    def __init__(self, world: World, camera: int, album: Path | None = None) -> None:
        self._world = world
        self._camera = camera
        self._album = album
        self._kept = 0
        self._optics = world.layout.camera_1 if camera == 1 else world.layout.camera_2
        self._rng = world.stream(f"camera {camera}")

    def __call__(self, exposure: Exposure) -> NDArray[np.uint8]:
        """The asked part of the sensor, (height, width), as at the middle of the exposure."""
        at_s = exposure.start_world_s + exposure.exposure_us * 0.5e-6
        scene = self._down(at_s) if self._camera == 1 else self._up(at_s)
        wear = self._world.wear[self._camera]
        light = wear.light_at(at_s) if self._world.lights[self._camera] else LIGHT_OFF
        gain = 10 ** (exposure.gain_db / 20) * exposure.exposure_us / NOMINAL_EXPOSURE_US
        optics = replace(self._optics, blur_px=wear.blur_px(self._optics.blur_px, at_s))
        seen = render(scene, optics, self._rng, exposure=light * gain)
        top, left = exposure.offset_y, exposure.offset_x
        picture = seen[top : top + exposure.height, left : left + exposure.width]
        if self._album is not None:
            self._keep(self._album, picture)
        return picture

    def _keep(self, album: Path, picture: NDArray[np.uint8]) -> None:
        """Save the picture as the camera sent it; not compressed, for the world waits."""
        self._kept += 1
        path = album / f"camera-{self._camera}-{self._kept:05d}.tif"
        cv2.imwrite(str(path), picture, [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_NONE])

    def warm(self) -> None:
        """See every kind of thing once: the first picture makes tables for all later ones and takes long."""
        product, here = self._world.product, Place(*_axis_mm(self._optics))
        things = parts.base(product.base), parts.battery(product.battery), parts.dot_plate()
        render(parts.scene(*((shapes, here) for shapes in things)), self._optics, self._rng)

    def _down(self, at_s: float) -> Scene:
        """Camera 1, in the frame of its carrier: board, base and the battery that lies in it."""
        world = self._world
        carrier = world.camera_1_carrier(at_s)
        from_room = self._leaning(at_s, world.layout.heights.camera_1_mm) @ carrier.back()
        axis = carrier.point(*_axis_mm(self._optics))
        shapes: list[Shape] = []
        if math.dist(axis, world.layout.board[:2]) < NEAR_MM:
            shapes += placed(parts.dot_plate(), from_room @ world.layout.board)
        base = world.base
        if base is not None and base.delivery.has_base:
            seated = world.seated
            thing = parts.assembly(base.drawing, seated.drawing, seated.place) if seated else parts.base(base.drawing)
            shapes += placed(thing, from_room @ base.place)
        return Scene(parts.BACKGROUND, shapes)

    def _up(self, at_s: float) -> Scene:
        """Camera 2, in robot coordinates: what hangs on the cup."""
        held = self._world.held
        if held is None:
            return Scene(CEILING_LEVEL, [])
        shapes = parts.battery(held.drawing) if isinstance(held, Battery) else parts.dot_plate()
        leaning = self._leaning(at_s, self._world.layout.heights.camera_2_mm)
        return Scene(CEILING_LEVEL, placed(shapes, leaning @ self._world.tool(at_s) @ held.place))

    def _leaning(self, at_s: float, in_focus_mm: float) -> Place:
        """How a tilted camera sees what is nearer than in focus: shifted. The second arm does not move with Z."""
        if self._camera == 1 and self._world.layout.carrier == "arm_2":
            return Place(0.0, 0.0)
        nearer_mm = self._world.arm.tool_at(at_s).z_mm - in_focus_mm
        lean_x, lean_y = self._optics.lean
        return Place(lean_x * nearer_mm, lean_y * nearer_mm)


def _axis_mm(optics: Optics) -> tuple[float, float]:
    x, y = optics.mm_from_px(np.array([(optics.width - 1) / 2, (optics.height - 1) / 2]))
    return float(x), float(y)
