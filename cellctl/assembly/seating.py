"""How a battery lies in its seat: what camera 1 should see of one of its corners, and what follows from that. Pure.

The corner is the one that camera 2 measures, so that this is what was placed. Gap and offset are differences between
points a fraction of a millimetre apart in one picture: they need the local scale only, and neither the place of the
camera nor that of the robot. Where the seat itself lies against the base is told by two stops of the robot.

The seat's frame is in the middle of the pocket; x runs along the battery's width.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellctl.assembly.views import CORNER_SIGNS, corner_mm, is_left, to_mm, to_px
from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Mm, Offset, Pose, direction_deg, wrap_deg
from cellctl.recipe import Recipe
from cellctl.vision.features import Edge, ExpectedEdge
from cellctl.vision.gap import ExpectedGap, GapMeasurement


class Seating(NamedTuple):
    """A seated battery, by one of its corners."""

    gap_x_mm: float  # between battery and seat, along the width
    gap_y_mm: float  # along the height
    offset: Offset  # of the corner against where the drawing has it in the seat's corner, turned about it
    sd_x_mm: float  # 1 sigma
    sd_y_mm: float
    sd_deg: float
    seat: Offset  # of the seat's corner against where base and robot make it expected
    worst_mm: float  # the furthest that any corner of the battery is off

    @property
    def against_base(self) -> Offset:
        """Of the battery against the base, whatever size the seat came out with."""
        (dx, dy, dt), (sx, sy, st) = self.offset, self.seat
        return Offset(dx + sx, dy + sy, wrap_deg(dt + st))

    def as_dict(self) -> dict[str, float]:
        """For the record."""
        (dx_mm, dy_mm, dt_deg), (sx_mm, sy_mm, st_deg) = self.offset, self.seat
        return {
            "x_um": self.gap_x_mm * 1000,
            "y_um": self.gap_y_mm * 1000,
            "dx_um": dx_mm * 1000,
            "dy_um": dy_mm * 1000,
            "dt_mdeg": dt_deg * 1000,
            "sd_x_um": self.sd_x_mm * 1000,
            "sd_y_um": self.sd_y_mm * 1000,
            "sd_t_mdeg": self.sd_deg * 1000,
            "seat_dx_um": sx_mm * 1000,
            "seat_dy_um": sy_mm * 1000,
            "seat_dt_mdeg": st_deg * 1000,
            "worst_um": self.worst_mm * 1000,
        }

    @property
    def sentence(self) -> str:
        """For the operator."""
        x, y, mdeg = (1000 * number for number in self.offset)
        return (
            f"gap {self.gap_x_mm * 1000:.0f} x {self.gap_y_mm * 1000:.0f} um, dX {x:+.1f} dY {y:+.1f} um "
            f"dT {mdeg:+.1f} mdeg, worst corner {self.worst_mm * 1000:.0f} um"
        )


def seat_pose(recipe: Recipe) -> Pose:
    """base_from_seat."""
    return Pose(recipe.base.seat_x_mm, recipe.base.seat_y_mm, recipe.base.seat_t_deg)


def seat_corner_mm(recipe: Recipe) -> Mm:
    """The corner in the frame of the seat, as drawn."""
    sx, sy = CORNER_SIGNS[recipe.battery.corner]
    return Mm(sx * recipe.seat_width_mm / 2, sy * recipe.seat_height_mm / 2)


def view_mm(recipe: Recipe) -> Mm:
    """The point of the base that camera 1 centres on: as far inside the corner as camera 2 looks at the battery."""
    (sx, sy), corner = CORNER_SIGNS[recipe.battery.corner], seat_corner_mm(recipe)
    inside = Mm(corner.x_mm - sx * recipe.battery.view_x_mm, corner.y_mm - sy * recipe.battery.view_y_mm)
    return seat_pose(recipe).point(*inside)


def expect_gap(plane: PlaneMap, recipe: Recipe, mount_from_base: Pose, blur_px: float) -> ExpectedGap:
    """Where the edges of the seat should appear when the base lies like this under the camera."""
    battery, corner, widest_mm = recipe.battery, seat_corner_mm(recipe), recipe.gap.search_mm + 2 * recipe.limits.gap_mm
    sx, sy = CORNER_SIGNS[battery.corner]
    along_x = Mm(corner.x_mm - sx * (battery.edge_skip_mm + battery.edge_x_mm), corner.y_mm)
    along_y = Mm(corner.x_mm, corner.y_mm - sy * (battery.edge_skip_mm + battery.edge_y_mm))
    outside = Mm(corner.x_mm + sx, corner.y_mm + sy)
    mount_from_seat = mount_from_base @ seat_pose(recipe)
    points = [mount_from_seat.point(*point) for point in (corner, along_x, along_y, outside)]
    start, end_x, end_y, out = to_px(plane, points)
    edges = [ExpectedEdge(start, end, is_left(start, end, out)) for end in (end_x, end_y)]
    return ExpectedGap(edges[0], edges[1], widest_mm / plane.mm_per_px, blur_px)


def seating(plane: PlaneMap, recipe: Recipe, seen: GapMeasurement, mount_from_base: Pose) -> Seating:
    """How the battery lies in its seat, and the seat in its base, by what camera 1 saw."""
    seat = _corner(plane, recipe, seen.slit_1.seat, seen.slit_2.seat)
    held = _corner(plane, recipe, seen.slit_1.battery, seen.slit_2.battery)
    along = 0 if recipe.battery.edge_x_mm >= recipe.battery.edge_y_mm else 1
    sd_y_mm, sd_x_mm = _spread_mm(plane, seen)
    sd_deg = math.sqrt((seen.slit_1, seen.slit_2)[along].covariance[1][1])
    return of_corners(recipe, mount_from_base, seat, held, (sd_x_mm, sd_y_mm, sd_deg))


def of_corners(
    recipe: Recipe, mount_from_base: Pose, seat: Pose, held: Pose, sd: tuple[float, float, float]
) -> Seating:
    """The same from the corners of seat and battery in the frame of the mount, x along the width."""
    signs, gap_mm = CORNER_SIGNS[recipe.battery.corner], recipe.limits.gap_mm
    lies = seat.inverse() @ held
    offset = Offset(lies.x_mm + signs[0] * gap_mm, lies.y_mm + signs[1] * gap_mm, lies.t_deg)
    expected = mount_from_base @ seat_pose(recipe) @ Pose(*seat_corner_mm(recipe), 0.0)
    return Seating(
        gap_x_mm=-signs[0] * lies.x_mm,
        gap_y_mm=-signs[1] * lies.y_mm,
        offset=offset,
        sd_x_mm=sd[0],
        sd_y_mm=sd[1],
        sd_deg=sd[2],
        seat=Offset(*(expected.inverse() @ seat)),
        worst_mm=worst_mm(recipe, offset),
    )


def _corner(plane: PlaneMap, recipe: Recipe, edge_x: Edge, edge_y: Edge) -> Pose:
    """The corner where two edges' lines meet, x along the width; the longer used edge gives the direction."""
    p, p_end, q, q_end = to_mm(plane, [edge_x.start, edge_x.end, edge_y.start, edge_y.end])
    d, e = (p_end.x_mm - p.x_mm, p_end.y_mm - p.y_mm), (q_end.x_mm - q.x_mm, q_end.y_mm - q.y_mm)
    part = ((q.x_mm - p.x_mm) * e[1] - (q.y_mm - p.y_mm) * e[0]) / (d[0] * e[1] - d[1] * e[0])
    (sx, sy), battery = CORNER_SIGNS[recipe.battery.corner], recipe.battery
    if battery.edge_x_mm >= battery.edge_y_mm:
        t_deg = direction_deg(p, p_end) - (0.0 if sx < 0 else 180.0)
    else:
        t_deg = direction_deg(q, q_end) - (90.0 if sy < 0 else -90.0)
    return Pose(p.x_mm + part * d[0], p.y_mm + part * d[1], wrap_deg(t_deg))


def _spread_mm(plane: PlaneMap, seen: GapMeasurement) -> tuple[float, float]:
    """1 sigma of both slits' widths at the corner, to which their lines are carried from their middles."""
    widths = []
    for slit in (seen.slit_1, seen.slit_2):
        lever_px = math.dist(slit.seat.middle, seen.seat_corner)
        turned_px = lever_px * math.radians(math.sqrt(slit.covariance[1][1]))
        widths.append(math.hypot(math.sqrt(slit.covariance[0][0]), turned_px) * plane.mm_per_px)
    return widths[0], widths[1]


def worst_mm(recipe: Recipe, offset: Offset) -> float:
    """How far the furthest corner of the battery is off when the measured one is off, and turned, like this."""
    moved, mark = Pose(*offset), corner_mm(recipe.battery)
    w, h = recipe.battery.width_mm / 2, recipe.battery.height_mm / 2
    away = [Mm(x - mark.x_mm, y - mark.y_mm) for x in (-w, w) for y in (-h, h)]
    return max(math.dist(moved.point(*corner), corner) for corner in away)
