"""How sure a unit's placement is: looks, stops of the robot, calibration and teaching, carried to the battery.

A unit is placed by its difference from a golden assembly that was looked at in the same way. So whatever errs at the
unit erred at the golden assembly too, averaged over repeats and pairs; that part goes by the name of teaching.

A second look shows a part once more from another stop of the robot: the reference edge some 50 mm further on, the
battery's opposite corner. What it says about the error of the first look is taken off it, weighted by how sure both
are: a wavy edge gives its direction to the long baseline, a straight one keeps it.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cellctl.assembly.looks import Outline, base_look, corner_look
from cellctl.assembly.map_error import MapError, twist
from cellctl.assembly.views import CORNER_SIGNS, Deviation, corner_mm
from cellctl.calibration.accuracy import Mark
from cellctl.config import CellConfig
from cellctl.geometry import Mm, Pose
from cellctl.learnt.calibrations import CameraCalibration
from cellctl.learnt.taught import Taught, TaughtCorner, TaughtEdge
from cellctl.mount import Stop
from cellctl.placement import Errors, Floats, Prediction, beside, learn, predict
from cellctl.recipe import Recipe
from cellctl.vision import BaseMeasurement, BatteryMeasurement
from cellctl.vision.features import Edge

STOP_NAMES = "robot stops", "robot stops", "R axis"
TEACHING, PART_SIZE = "teaching", "part size"
BASE_FORM, BATTERY_FORM = "base edge form", "battery edge form"
AND_LINE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])  # to rows of a base's look


class Located(NamedTuple):
    """Where a part is, and how sure that is: its frame's errors by source."""

    pose: Pose  # robot_from_base or tool_from_battery
    errors: Errors


class EdgeAgain(NamedTuple):
    """The second stretch of a base's edge, and how it lies against the first. No edge: a perfect picture of it."""

    edge: Edge | None
    found: Deviation


class CornerAgain(NamedTuple):
    """A battery by its opposite corner alone. No measurement: a perfect picture of it."""

    seen: BatteryMeasurement | None
    tool_from_battery: Pose


class Needs(NamedTuple):
    """Which part is looked at twice."""

    base_again: bool
    battery_again: bool


@dataclass(frozen=True)
class Budget:
    """All that is known about errors before a unit is seen."""

    config: CellConfig
    recipe: Recipe
    calibrations: tuple[CameraCalibration, CameraCalibration]
    taught: Taught

    # -- the parts ---------------------------------------------------------------------------------------------

    def base(self, seen: BaseMeasurement | None, robot_from_base: Pose, again: EdgeAgain | None = None) -> Located:
        """The base by one look or two. No measurement: a perfect picture of it."""
        mount_from_base = self.config.mount_1.frame(self.taught.look_1).inverse() @ robot_from_base
        stop = self._stop_of_camera_1(self.taught.look_1, robot_from_base).mapped(AND_LINE)
        look = base_look(self._base_outline, self.recipe.base, seen, mount_from_base.t_deg).and_of(stop)
        calibration = self._calibration_1.at(mount_from_base)
        if again is None:
            return Located(robot_from_base, self._with_teaching(look).mapped(np.eye(3, 4)).and_of(calibration))
        both = self._with_teaching(beside(look, self._second_look_at_base(again.edge, robot_from_base)))
        middle_mm = self.recipe.base.second_view.view_x_mm
        difference = both.mapped([[0, 0, -middle_mm, -1, 1, 0], [0, 0, -1, 0, 0, 1]])
        learnt = learn(both.mapped(np.eye(3, 6)), difference, np.subtract(again.found, self.second_edge.found))
        return Located(robot_from_base @ _undoing(learnt.error), learnt.left.and_of(calibration))

    def battery(
        self, seen: BatteryMeasurement | None, tool_from_battery: Pose, again: CornerAgain | None = None
    ) -> Located:
        """The battery by one look or two. No measurement: a perfect picture of it."""
        battery, stop = self.recipe.battery, self._stop.seen_from(tool_from_battery.inverse())
        look = corner_look(self._battery_outline, battery, seen).and_of(stop)
        sx, sy = CORNER_SIGNS[battery.corner]
        size = np.array([[sx, 0], [0, sy], [0, 0]])  # half of what it is larger by puts its middle so far off
        first, calibration = (
            np.hstack([np.eye(3), size]),
            self._calibration_2.at(self.taught.look_2 @ tool_from_battery),
        )
        if again is None:
            both = self._with_teaching(beside(look, self._half_size))
            return Located(tool_from_battery, both.mapped(first).and_of(calibration))
        other = corner_look(self._battery_outline, battery.diagonal, again.seen).and_of(stop)
        both = self._with_teaching(beside(look, self._half_size, other))
        difference = both.mapped(np.hstack([-np.eye(3), -2 * size, np.eye(3)]))
        by = twist(self.second_corner.found, tool_from_battery.inverse() @ again.tool_from_battery)
        learnt = learn(both.mapped(np.pad(first, ((0, 0), (0, 3)))), difference, by)
        return Located(tool_from_battery @ _undoing(learnt.error), learnt.left.and_of(calibration))

    def errors(self, base: Located, battery: Located) -> Errors:
        """Of a battery that is placed by these: 3 rows of its frame in the seat."""
        at_seat = self._with_teaching(self._stop_at_seat.seen_from(battery.pose.inverse()))
        of_base = base.errors.seen_from(self.taught.base_from_battery.inverse())
        return of_base.and_of(battery.errors).and_of(at_seat)

    def placement(self, base: Located, battery: Located) -> Prediction:
        """The worst corner of the battery when it is placed by these."""
        return predict(self.errors(base, battery), self.corners, self.recipe.limits.placement_mm)

    @property
    def corners(self) -> list[Mm]:
        """Of the battery as drawn, in its frame."""
        w, h = self.recipe.battery.width_mm / 2, self.recipe.battery.height_mm / 2
        return [Mm(-w, -h), Mm(w, -h), Mm(w, h), Mm(-w, h)]

    # -- when to look again ------------------------------------------------------------------------------------

    @cached_property
    def needs(self) -> Needs:
        """Known before any unit is seen, for pictures are the smallest part of the error."""
        policy, has_edge = self.recipe.placement.second_look, self.taught.second_edge is not None
        if policy == "never":
            return Needs(False, False)
        base = has_edge and (policy == "always" or self._misses_aim(Needs(False, True)))
        return Needs(base, policy == "always" or self._misses_aim(Needs(base, False)))

    def _misses_aim(self, looks: Needs) -> bool:
        return self.planned(looks).p99_mm > self.recipe.aim_mm

    @property
    def may_look_again(self) -> bool:
        """Whether a battery that turns out to be too uncertain may be looked at again."""
        return self.recipe.placement.second_look == "when_needed"

    @property
    def plan_text(self) -> str:
        """What is expected of the units to come, for the log."""
        times = {False: "once", True: "twice"}
        looks = f"base looked at {times[self.needs.base_again]}, battery {times[self.needs.battery_again]}"
        return f"planned: {self.planned(self.needs).sentence}; {looks}"

    def planned(self, looks: Needs) -> Prediction:
        """The placement of a unit like the golden one, in perfect pictures."""
        taught, edge, corner = self.taught, None, None
        if looks.base_again:
            edge = EdgeAgain(None, self.second_edge.found)
        if looks.battery_again:
            corner = CornerAgain(None, taught.tool_from_battery @ self.second_corner.found)
        base = self.base(None, taught.robot_from_base, edge)
        return self.placement(base, self.battery(None, taught.tool_from_battery, corner))

    @property
    def second_edge(self) -> TaughtEdge:
        """Raises ValueError when it was not taught."""
        if self.taught.second_edge is None:
            raise ValueError("no second look at the base was taught")
        return self.taught.second_edge

    @property
    def second_corner(self) -> TaughtCorner:
        """Raises ValueError when it was not taught."""
        if self.taught.second_corner is None:
            raise ValueError("no second look at the battery was taught")
        return self.taught.second_corner

    # -- what errs ---------------------------------------------------------------------------------------------

    @cached_property
    def _noise(self) -> tuple[float, float]:
        """The robot's repeatability, 1 sigma in mm and deg: as stated, or as the calibrations found it if worse."""
        robot, found = self.config.robot, [calibration.robot_factor for calibration in self.calibrations]
        worse = max(1.0, math.sqrt(sum(factor**2 for factor in found) / len(found)))
        return robot.repeatability_mm / 3 * worse, robot.repeatability_deg / 3 * worse

    @cached_property
    def _stop(self) -> Errors:
        """3 rows: where the tool stands against where it was sent."""
        sd_mm, sd_deg = self._noise
        return Errors(STOP_NAMES, np.diag([sd_mm, sd_mm, math.radians(sd_deg)]))

    @cached_property
    def _stop_at_seat(self) -> Errors:
        """The same of the one stop that is not chosen so that the controller can be told it exactly."""
        sd_mm, sd_deg = (math.hypot(sd, self.config.robot.step / math.sqrt(12)) for sd in self._noise)
        return Errors(STOP_NAMES, np.diag([sd_mm, sd_mm, math.radians(sd_deg)]))

    def _stop_of_camera_1(self, look: Pose, robot_from_base: Pose) -> Errors:
        """3 rows: what a stop of the arm does to the base that camera 1 sees from there."""
        mount = self.config.mount_1
        scatter = Errors(STOP_NAMES, mount.scatter([Stop(look, mount.elbow)], *self._noise)[0])
        return scatter.seen_from(robot_from_base.inverse() @ Pose(look.x_mm, look.y_mm, 0.0))

    def _second_look_at_base(self, edge: Edge | None, robot_from_base: Pose) -> Errors:
        """2 rows: offset and turn of the second stretch, in the base's frame."""
        view, stop = self.recipe.base.second_view, self._stop_of_camera_1(self.second_edge.stop, robot_from_base)
        stretch = self._base_outline.edge(edge, view.edge_to_mm - view.edge_from_mm)
        return stretch.and_of(stop.mapped([[0, 1, view.view_x_mm], [0, 0, 1]]))

    def _with_teaching(self, unit: Errors) -> Errors:
        """With the same errors of the golden assemblies."""
        return unit.and_of(self._golden(unit, self._worse_taught))

    def _golden(self, unit: Errors, worse: float) -> Errors:
        """What of the unit's sources the golden assemblies had: averaged, and their sizes are those drawn."""
        form = 1.0 / math.sqrt(self.taught.pairs)
        factors = {BASE_FORM: form, BATTERY_FORM: form, PART_SIZE: 0.0}
        return unit.scaled(factors, worse * form / math.sqrt(self.taught.repeats)).named(TEACHING)

    @cached_property
    def _worse_taught(self) -> float:
        """How many times more than the robot's stops explain the seatings of one pair scattered: people differ."""
        taught = self.taught
        base_stop = self._stop_of_camera_1(taught.look_1, taught.robot_from_base)
        at_camera_2 = at_seat = self._stop.seen_from(taught.tool_from_battery.inverse())
        in_battery = base_stop.seen_from(taught.base_from_battery.inverse())
        xx, yy, tt = np.diag(in_battery.and_of(at_camera_2).and_of(at_seat).covariance).tolist()
        found = taught.spread_mm / math.sqrt((xx + yy) / 2), math.radians(taught.spread_deg) / math.sqrt(tt)
        return max(1.0, *found)

    @cached_property
    def _half_size(self) -> Errors:
        """2 rows: half of what the battery is wider and higher than drawn."""
        half_mm = self.recipe.placement.battery_size_sd_mm / 2
        return Errors((PART_SIZE, PART_SIZE), half_mm * np.eye(2))

    @cached_property
    def _base_outline(self) -> Outline:
        stated, plane = self.recipe.placement, self.calibrations[0].plane
        return Outline("camera 1", plane, BASE_FORM, stated.base_form_um / 1000, stated.form_length_mm)

    @cached_property
    def _battery_outline(self) -> Outline:
        stated, plane = self.recipe.placement, self.calibrations[1].plane
        return Outline("camera 2", plane, BATTERY_FORM, stated.battery_form_um / 1000, stated.form_length_mm)

    @cached_property
    def _calibration_1(self) -> MapError:
        """What camera 1's calibration does to the difference from the taught base."""
        base, y_mm = self.recipe.base, self.recipe.base.edge_distance_mm
        mark = Mark(Mm(0.0, 0.0), (Mm(base.edge_from_mm, y_mm), Mm(base.edge_to_mm, y_mm)))
        golden = self.config.mount_1.frame(self.taught.look_1).inverse() @ self.taught.robot_from_base
        return _map_error("calibration camera 1", self.calibrations[0], golden, mark)

    @cached_property
    def _calibration_2(self) -> MapError:
        """What camera 2's calibration does to the difference from the taught battery, tool centre included."""
        battery, taught = self.recipe.battery, self.taught
        (sx, sy), corner = CORNER_SIGNS[battery.corner], corner_mm(battery)
        along_x = battery.edge_x_mm >= battery.edge_y_mm
        step = Mm(-sx * battery.edge_x_mm, 0.0) if along_x else Mm(0.0, -sy * battery.edge_y_mm)
        mark = Mark(corner, (corner, Mm(corner.x_mm + step.x_mm, corner.y_mm + step.y_mm)))
        return _map_error("calibration camera 2", self.calibrations[1], taught.look_2 @ taught.tool_from_battery, mark)


def _undoing(error: Floats) -> Pose:
    """The motion that takes an error off a pose."""
    x_mm, y_mm, turn_rad = error.tolist()
    return Pose(-x_mm, -y_mm, -math.degrees(turn_rad))


def _map_error(name: str, calibration: CameraCalibration, taught: Pose, mark: Mark) -> MapError:
    return MapError.of(name, calibration.plane, calibration.covariance_array, taught, mark)
