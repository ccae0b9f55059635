"""Units as a cell places them, without pictures and wires: true poses, a robot that misses, cameras that have moved.

Only where things truly are and what the cameras make of it is simulated; where to place, how the battery lies and
what follows for the drift comes from the product. For tests and benchmarks that need thousands of units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cellctl.assembly import seating
from cellctl.assembly.views import corner_mm
from cellctl.geometry import Pose, place_pose, wrap_deg
from cellctl.monitoring.drift import Drift, Observation
from cellctl.monitoring.watch import Watch
from cellctl.recipe import Recipe, load_recipe

RECIPE = load_recipe(Path(__file__).resolve().parent.parent / "recipes", "x85")
STATION, TABLE, CAMERA_2 = Pose(282.0, 120.0, 0.0), Pose(200.0, -220.0, 0.0), Pose(300.0, -120.0, 0.0)
CAMERA_1 = Pose(55.0, 0.0, 0.0)  # its axis in the tool frame
SCATTER = Pose(0.05, 0.15, 0.228)  # of the bases: half widths in mm, sigma in degrees
TURNED_DEG = 0.135
BATTERY_MM, BATTERY_DEG = 1.0, 1.0
SIZE_SD_MM = 0.02
ANGLE_SD_DEG = (0.0006, 0.0011)  # of the base's edge and of the battery's in a picture


@dataclass
class Imperfect:
    """What has gone wrong since the cell was taught. All in the frame of the robot at R = 0."""

    camera_1_mm: tuple[float, float] = (0.0, 0.0)  # camera 1 has moved on its mount
    camera_2_mm: tuple[float, float] = (0.0, 0.0)  # camera 2 has moved on its bench
    camera_2_scale: float = 0.0
    tool_centre_mm: tuple[float, float] = (0.0, 0.0)  # the rotation centre has always been off by so much
    seat_t_deg: float = 0.0  # R has lost some angle at the seat


@dataclass
class DriftCell:
    """A cell that makes a unit in some microseconds."""

    rng: np.random.Generator
    recipe: Recipe = RECIPE
    repeat_mm: float = 0.01  # 3 sigma
    repeat_deg: float = 0.004
    taught_sd_mm: float = 0.002
    wrong: Imperfect = field(default_factory=Imperfect)

    def __post_init__(self) -> None:
        """Taught by a perfect golden assembly, but for an error of the mean, by the cameras as they are."""
        x, y, t = self.rng.normal(0.0, self.taught_sd_mm, 3).tolist()
        seat = seating.seat_pose(self.recipe)
        self.look_1 = Pose(STATION.x_mm - CAMERA_1.x_mm, STATION.y_mm + 2.0, 0.0)
        self.look_2 = CAMERA_2 @ Pose(22.0, 39.0, 0.0)
        self.tool_from_battery = self.look_2.inverse() @ self._by_camera_2(self.look_2)
        seen_base = self.look_1 @ self._by_camera_1(self.look_1.inverse() @ STATION)
        golden = STATION @ seat
        self.base_from_battery = seen_base.inverse() @ golden @ self.tool_from_battery @ Pose(x, y, t / 4)
        self.golden = place_pose(seen_base, self.base_from_battery, self.tool_from_battery)
        self.watch = Watch("golden", self.recipe, Drift())

    def units(self, count: int) -> Iterator[Observation]:
        """So many units, each of them seen by the watch."""
        for _ in range(count):
            seen = self.unit()
            self.watch.see(seen)
            yield seen

    def unit(self) -> Observation:
        """One base, one battery, three stops and the look at the gap."""
        rng, turned = self.rng, float(self.rng.normal(TURNED_DEG, SCATTER.t_deg))
        base = STATION @ Pose(*(rng.uniform(-1, 1, 2) * SCATTER[:2]).tolist(), turned)
        lies = Pose(*(rng.uniform(-1, 1, 2) * BATTERY_MM).tolist(), float(rng.uniform(-1, 1) * BATTERY_DEG))
        in_tool = self._stop(TABLE).inverse() @ TABLE @ lies
        seen_base = self.look_1 @ self._by_camera_1(self._stop(self.look_1).inverse() @ base)
        seen_base = seen_base @ Pose(0.0, 0.0, float(rng.normal(0.0, ANGLE_SD_DEG[0])))
        held = self.look_2.inverse() @ self._by_camera_2(self._stop(self.look_2) @ in_tool)
        held = self._turned_about_mark(held, float(rng.normal(0.0, ANGLE_SD_DEG[1])))
        to = place_pose(seen_base, self.watch.corrected(self.base_from_battery), held)
        placed_at = Pose(*(round(number, 3) for number in to))
        at_seat = self._stop(placed_at) @ Pose(0.0, 0.0, self.wrong.seat_t_deg)
        lying = self._seen_in_seat(base, seen_base, at_seat @ in_tool)
        return self._observation(placed_at, held, lying)

    def _seen_in_seat(self, base: Pose, seen_base: Pose, battery: Pose) -> seating.Seating:
        sizes = self.rng.normal(0.0, SIZE_SD_MM, 2) / 2
        corner, mark = seating.seat_corner_mm(self.recipe), corner_mm(self.recipe.battery)
        grown = Pose(corner.x_mm - float(sizes[0]), corner.y_mm - float(sizes[1]), 0.0)
        view = seen_base.point(*seating.view_mm(self.recipe))
        stop = Pose(view.x_mm - CAMERA_1.x_mm, view.y_mm, 0.0)
        back = self._stop(stop).inverse()
        seat = self._by_camera_1(back @ base @ seating.seat_pose(self.recipe) @ grown)
        held = self._by_camera_1(back @ battery @ Pose(*mark, 0.0))
        return seating.of_corners(self.recipe, stop.inverse() @ seen_base, seat, held, (1e-4, 1e-4, 1e-4))

    def _observation(self, placed_at: Pose, held: Pose, lying: seating.Seating) -> Observation:
        mark = corner_mm(self.recipe.battery)
        here, there = held.point(*mark), self.tool_from_battery.point(*mark)
        dx_mm, dy_mm, dt_deg = lying.against_base
        return Observation(
            dx_mm * 1000,
            dy_mm * 1000,
            dt_deg * 1000,
            wrap_deg(placed_at.t_deg - self.golden.t_deg),
            here.x_mm - there.x_mm,
            here.y_mm - there.y_mm,
        )

    def _stop(self, at: Pose) -> Pose:
        """Where the tool truly stands, sent there."""
        x, y, t = self.rng.normal(0.0, 1.0, 3).tolist()
        return Pose(
            at.x_mm + x * self.repeat_mm / 3, at.y_mm + y * self.repeat_mm / 3, at.t_deg + t * self.repeat_deg / 3
        )

    def _turned_about_mark(self, held: Pose, turn_deg: float) -> Pose:
        mark = corner_mm(self.recipe.battery)
        return held @ Pose(*mark, turn_deg) @ Pose(-mark.x_mm, -mark.y_mm, 0.0)

    def _by_camera_1(self, tool_from_thing: Pose) -> Pose:
        dx, dy = self.wrong.camera_1_mm
        return tool_from_thing._replace(x_mm=tool_from_thing.x_mm + dx, y_mm=tool_from_thing.y_mm + dy)

    def _by_camera_2(self, robot_from_battery: Pose) -> Pose:
        """The corner is what camera 2 sees; its scale acts about the middle of its picture."""
        mark, wrong = corner_mm(self.recipe.battery), self.wrong
        at = robot_from_battery.point(*mark)
        middle = self.look_2.point(mark.x_mm + 4.5, mark.y_mm + 3.5)
        dx = wrong.camera_2_mm[0] + wrong.tool_centre_mm[0] + wrong.camera_2_scale * (at.x_mm - middle.x_mm)
        dy = wrong.camera_2_mm[1] + wrong.tool_centre_mm[1] + wrong.camera_2_scale * (at.y_mm - middle.y_mm)
        seen = Pose(at.x_mm + dx, at.y_mm + dy, robot_from_battery.t_deg)
        return seen @ Pose(-mark.x_mm, -mark.y_mm, 0.0)
