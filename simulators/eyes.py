"""What the two cameras of the cell see at a moment: the world's things, composed for the renderer."""

import math

import numpy as np
from numpy.typing import NDArray

from simulators import parts
from simulators.gige import Exposure
from simulators.place import Place
from simulators.render import Optics, Scene, Shape, placed, render
from simulators.things import Battery
from simulators.world import World

CEILING_LEVEL = 20.0
NOMINAL_EXPOSURE_US = 2000.0
LIGHT_OFF = 0.02
NEAR_MM = 60.0  # a thing further from a camera's axis than its own size and this is not drawn


class Eye:
    """One camera's view of the world: called by its protocol simulator for every exposure."""

    def __init__(self, world: World, camera: int) -> None:
        self._world = world
        self._camera = camera
        self._optics = world.layout.camera_1 if camera == 1 else world.layout.camera_2
        self._rng = world.stream(f"camera {camera}")

    def __call__(self, exposure: Exposure) -> NDArray[np.uint8]:
        """The asked part of the sensor, (height, width), as at the middle of the exposure."""
        at_s = exposure.start_world_s + exposure.exposure_us * 0.5e-6
        scene = self._down(at_s) if self._camera == 1 else self._up(at_s)
        light = 1.0 if self._world.lights[self._camera] else LIGHT_OFF
        gain = 10 ** (exposure.gain_db / 20) * exposure.exposure_us / NOMINAL_EXPOSURE_US
        fault = self._world.light_fault.get(self._camera, 1.0)
        seen = render(scene, self._optics, self._rng, exposure=light * gain * fault)
        top, left = exposure.offset_y, exposure.offset_x
        return seen[top : top + exposure.height, left : left + exposure.width]

    def warm(self) -> None:
        """See every kind of thing once: the first picture makes tables for all later ones and takes long."""
        product, here = self._world.product, Place(*_axis_mm(self._optics))
        things = parts.base(product.base), parts.battery(product.battery), parts.dot_plate()
        render(parts.scene(*((shapes, here) for shapes in things)), self._optics, self._rng)

    def _down(self, at_s: float) -> Scene:
        """Camera 1, in the tool frame: board, base and the battery that lies in it."""
        world = self._world
        tool_from_room = world.tool(at_s).back()
        axis = tool_from_room.back().point(*_axis_mm(self._optics))
        shapes: list[Shape] = []
        if math.dist(axis, world.layout.board[:2]) < NEAR_MM:
            shapes += placed(parts.dot_plate(), tool_from_room @ world.layout.board)
        base = world.base
        if base is not None and base.delivery.has_base:
            shapes += placed(parts.base(base.drawing), tool_from_room @ base.place)
            if world.seated is not None:
                seated = base.place @ world.product.seat @ world.seated.place
                shapes += placed(parts.battery(world.seated.drawing), tool_from_room @ seated)
        return Scene(parts.BACKGROUND, shapes)

    def _up(self, at_s: float) -> Scene:
        """Camera 2, in robot coordinates: what hangs on the cup."""
        held = self._world.held
        if held is None:
            return Scene(CEILING_LEVEL, [])
        shapes = parts.battery(held.drawing) if isinstance(held, Battery) else parts.dot_plate()
        return Scene(CEILING_LEVEL, placed(shapes, self._world.tool(at_s) @ held.place))


def _axis_mm(optics: Optics) -> tuple[float, float]:
    x, y = optics.mm_from_px(np.array([(optics.width - 1) / 2, (optics.height - 1) / 2]))
    return float(x), float(y)
