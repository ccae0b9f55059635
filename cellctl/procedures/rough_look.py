"""The first looks at a board: four pictures tell roughly how the camera stands, so that poses can be planned."""

from dataclasses import dataclass

import numpy as np

from cellctl.assembly.hand import commanded
from cellctl.calibration.errors import BoardNotFound, PlanImpossible
from cellctl.calibration.plan import Task
from cellctl.calibration.rough import back_into_view, rough_setup, rough_steps
from cellctl.calibration.scara import FloatArray, Setup
from cellctl.calibration.view import board_middle, picture_centre_px
from cellctl.geometry import Px
from cellctl.keep_out import touched_on_the_way
from cellctl.mount import Elbow, OutOfReach, Stop
from cellctl.procedures.board_looks import BoardLooks, Eye

TURN_DEG = 20.0  # enough to see where the camera is, too little for the board to leave the picture
MOST_LOOKS = 4  # at a board that is not where the cell was drawn


@dataclass(frozen=True)
class RoughLook:
    """One camera's first looks; its task holds the setup as drawn."""

    looks: BoardLooks
    eye: Eye
    task: Task

    async def setup(self) -> Setup:
        """The setup as it roughly is. Raises CalibrationError."""
        task = self.task
        start, first = await self._found(0.0, task.mount.elbow)
        steps = [
            as_commanded(start._replace(tool=start.tool._replace(x_mm=step.x_mm, y_mm=step.y_mm)))
            for step in rough_steps(task.setup, task.frame(start), first, task.picture_px)
        ]
        rest = [await self._dots(step) for step in steps]
        turned, last = await self._turned(start)
        poses = [task.frame(stop) for stop in (start, *steps, turned)]
        return rough_setup(task.setup, poses, np.stack([first, *rest, last]), task.board, task.picture_px)

    async def _turned(self, start: Stop) -> tuple[Stop, FloatArray]:
        """The board from another side: R turned, or for a camera on the second arm the elbow on its other side."""
        if self.task.mount.part == "tool":
            wanted_deg = min(TURN_DEG, self.looks.config.calibration.rotation_deg)
            way = 1.0 if self.task.possible(self._stop(self._middle, wanted_deg, start.elbow)) else -1.0
            return await self._found(way * wanted_deg, start.elbow)
        other: Elbow = "lefty" if start.elbow == "righty" else "righty"
        end = self._stop(self._middle, 0.0, other)
        if area := touched_on_the_way(self.task.mount, start, end, self.task.areas):
            raise PlanImpossible(
                "keep-out", f"the elbow cannot change sides over the board: the arm would touch {area!r}"
            )
        return await self._found(0.0, other)

    async def _found(self, turn_deg: float, elbow: Elbow) -> tuple[Stop, FloatArray]:
        """Look where the board should be in the picture's middle; if it leaves the picture, go after it."""
        at = self._middle
        for _ in range(MOST_LOOKS - 1):
            stop = self._stop(at, turn_deg, elbow)
            try:
                return stop, await self._dots(stop)
            except BoardNotFound as error:
                if not error.sides:
                    raise
                at = back_into_view(at, error.sides, self.task.picture_px)
        stop = self._stop(at, turn_deg, elbow)
        return stop, await self._dots(stop)

    @property
    def _middle(self) -> Px:
        u, v = picture_centre_px(self.task.picture_px).tolist()
        return Px(u, v)

    def _stop(self, at: Px, turn_deg: float, elbow: Elbow) -> Stop:
        try:
            return as_commanded(self.task.stop_seeing(board_middle(self.task.board), at, turn_deg, elbow))
        except OutOfReach as error:
            raise PlanImpossible("reach", f"{error}: move the board") from error

    async def _dots(self, stop: Stop) -> FloatArray:
        if not self.task.possible(stop):
            where = f"X {stop.tool.x_mm:.1f} Y {stop.tool.y_mm:.1f} R {stop.tool.t_deg:.1f} ({stop.elbow})"
            raise PlanImpossible("reach", f"the first look at the board would be from {where}: move the board")
        return await self.looks.dots(self.eye, stop, "rough look")


def as_commanded(stop: Stop) -> Stop:
    """The stop as the controller is told it."""
    return stop._replace(tool=commanded(stop.tool))
