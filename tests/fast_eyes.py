"""How the cameras of the fast cell see: by exact projection with the noise a measurement claims, or by pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cellctl.assembly import views
from cellctl.assembly.hand import commanded
from cellctl.assembly.sight import KNOWN_DEG, KNOWN_MM
from cellctl.calibration.board import DotBoard
from cellctl.calibration.dots import find_dots
from cellctl.calibration.hand_eye import solve_hand_eye
from cellctl.calibration.parameters import PARAMETERS
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.problem import Looks
from cellctl.calibration.scara import Kind, Noise
from cellctl.geometry import Pose, Px
from cellctl.learnt.calibrations import CameraCalibration
from cellctl.learnt.references import Eye, now
from cellctl.recipe import Recipe
from cellctl.recipe_parts import Base as BasePart
from cellctl.recipe_parts import Battery as BatteryPart
from cellctl.vision import (
    Appearance,
    BaseMeasurement,
    BatteryMeasurement,
    Circle,
    Edge,
    Limits,
    Search,
    find_base,
    find_battery,
    find_edge,
)
from cellctl.vision.covariance import corner_covariance
from cellctl.vision.features import Floats, Pixels
from simulators import parts
from simulators.eyes import CEILING_LEVEL
from simulators.optics import Optics
from simulators.place import Place
from simulators.render import Scene, placed, render
from simulators.things import Base, Battery
from tests.fast_cell import FastCell
from tests.vision_scenes import clutter

POSES = 15
CLEAN = Appearance(1.1, 90.0, 2.5, 40.0, 130.0, 0.0)


@dataclass
class ExactEyes:
    """Features where the true optics put them, each missed by normal errors of the stated size. Parts are straight."""

    recipe: Recipe
    optics: tuple[Optics, Optics]
    rng: np.random.Generator
    place_px: float = 0.01
    angle_deg: float = 0.0005

    def base(self, tool: Place, base: Base, tool_from_base: Pose) -> BaseMeasurement:
        """Hole and edge."""
        there = tool.back() @ base.place
        u, v = self._px(0, there, [(0.0, 0.0)])[0]
        du, dv = self.rng.normal(0.0, self.place_px, 2)
        variance = self.place_px**2
        radius = self.recipe.base.hole_radius_mm * self.optics[0].px_per_mm
        hole = Circle(Px(u + du, v + dv), radius, ((variance, 0.0), (0.0, variance)), CLEAN, 1.0, 0.02)
        return BaseMeasurement(hole, self._stretch(there, self.recipe.base), 0.0)

    def edge(self, tool: Place, base: Base, tool_from_base: Pose) -> Edge:
        """The second stretch."""
        return self._stretch(tool.back() @ base.place, self.recipe.base.second_view)

    def battery(
        self, tool: Place, battery: Battery, robot_from_battery: Pose, *, opposite: bool = False
    ) -> BatteryMeasurement:
        """A corner of the battery as it truly is."""
        part = self.recipe.battery.diagonal if opposite else self.recipe.battery
        made = part.model_copy(update={"width_mm": battery.size.width_mm, "height_mm": battery.size.height_mm})
        corner, (sx, sy) = views.corner_mm(made), views.CORNER_SIGNS[made.corner]
        skip = part.edge_skip_mm
        there = tool @ battery.place
        ends = [
            [(corner.x_mm - sx * skip, corner.y_mm), (corner.x_mm - sx * (skip + part.edge_x_mm), corner.y_mm)],
            [(corner.x_mm, corner.y_mm - sy * skip), (corner.x_mm, corner.y_mm - sy * (skip + part.edge_y_mm))],
        ]
        one, two = (self._missed(*self._px(1, there, points)) for points in ends)
        meet = _meet(one, two)
        return BatteryMeasurement(one, two, meet, corner_covariance(meet, one, two), 0.0)

    def _stretch(self, there: Place, part: BasePart) -> Edge:
        points = [(x_mm, part.edge_distance_mm) for x_mm in (part.edge_from_mm, part.edge_to_mm)]
        return self._missed(*self._px(0, there, points))

    def _px(self, camera: int, there: Place, points: list[tuple[float, float]]) -> list[Px]:
        seen = self.optics[camera].px_from_mm(np.array([there.point(*point) for point in points]))
        return [Px(float(u), float(v)) for u, v in seen]

    def _missed(self, start: Px, end: Px) -> Edge:
        """An edge, shifted across and turned about its middle."""
        across, turn = self.rng.normal(0.0, self.place_px), math.radians(self.rng.normal(0.0, self.angle_deg))
        du, dv, length = end.u - start.u, end.v - start.v, math.dist(start, end)
        ends = []
        for point, away in ((start, -0.5), (end, 0.5)):
            off = across + turn * away * length
            ends.append(Px(point.u - dv / length * off, point.v + du / length * off))
        covariance = ((self.place_px**2, 0.0), (0.0, self.angle_deg**2))
        return Edge(ends[0], ends[1], covariance, CLEAN, 1.0, 0.02)


def _meet(one: Edge, two: Edge) -> Px:
    a, b = np.array(one.start), np.array(two.start)
    ways = np.stack([np.subtract(one.end, one.start), -np.subtract(two.end, two.start)], axis=1)
    u, v = a + ways[:, 0] * np.linalg.solve(ways, b - a)[0]
    return Px(float(u), float(v))


@dataclass
class RenderedEyes:
    """Pictures of the true scene, measured by the controller's finders."""

    recipe: Recipe
    optics: tuple[Optics, Optics]
    planes: tuple[PlaneMap, PlaneMap]
    rng: np.random.Generator
    nuisances: bool = False

    def base(self, tool: Place, base: Base, tool_from_base: Pose) -> BaseMeasurement:
        """Hole and edge."""
        expected = views.expect_base(self.planes[0], self.recipe.base, tool_from_base)
        return find_base(self._of_base(tool, base), *expected, self._search(self.recipe.base, 0), self._limits(0))

    def edge(self, tool: Place, base: Base, tool_from_base: Pose) -> Edge:
        """The second stretch."""
        view = self.recipe.base.second_view
        expected = views.expect_edge(self.planes[0], view, tool_from_base)
        search = Search(KNOWN_MM / self.planes[0].mm_per_px, KNOWN_DEG)
        return find_edge(self._of_base(tool, base), expected, search, self._limits(0))

    def battery(
        self, tool: Place, battery: Battery, robot_from_battery: Pose, *, opposite: bool = False
    ) -> BatteryMeasurement:
        """A corner."""
        part = self.recipe.battery.diagonal if opposite else self.recipe.battery
        expected = views.expect_battery(self.planes[1], part, robot_from_battery)
        shapes = placed(parts.battery(battery.drawing), tool @ battery.place)
        pixels = self._picture(Scene(CEILING_LEVEL, shapes), 1)
        return find_battery(pixels, *expected, self._search(part, 1), self._limits(1))

    def _of_base(self, tool: Place, base: Base) -> Pixels:
        shapes = placed(parts.base(base.drawing), tool.back() @ base.place)
        return self._picture(Scene(parts.BACKGROUND, shapes), 0)

    def _picture(self, scene: Scene, camera: int) -> Pixels:
        optics = self.optics[camera]
        if not self.nuisances:
            return render(scene, optics, self.rng)
        noise = float(self.rng.integers(4, 17)) / 2.0  # in steps: the renderer keeps what it has made of each
        worn = replace(optics, blur_px=float(self.rng.uniform(0.8, 2.0)), noise=noise)
        dirty = Scene(scene.background, [*scene.shapes, *clutter(self.rng, optics)])
        return render(dirty, worn, self.rng, exposure=float(self.rng.uniform(0.7, 1.1)))

    def _search(self, part: BasePart | BatteryPart, camera: int) -> Search:
        return views.search_px(self.planes[camera], part)

    def _limits(self, camera: int) -> Limits:
        return views.limits_px(self.planes[camera], self.recipe)


def known_exactly(name: Eye, optics: Optics) -> CameraCalibration:
    """A calibration without any error."""
    plane = PlaneMap.from_arrays(optics.matrix, optics.offset_px, optics.k1, optics.centre_px)
    return _calibration(name, plane, np.zeros((len(PARAMETERS), len(PARAMETERS))), 1.0)


def calibrated(cell: FastCell, name: Eye, rng: np.random.Generator) -> CameraCalibration:
    """By pictures of the dot board from 15 stops, as the cell calibrates itself, good or bad as the arm is."""
    layout, first = cell.layout, name == "camera-1"
    optics, board = (layout.camera_1 if first else layout.camera_2), DotBoard()
    middle = board.outline_mm.mean(axis=0)
    held = Place(float(-middle[0]), float(-middle[1]), 0.7)
    poses, dots = [], []
    for turn_deg in np.linspace(-25.0, 25.0, POSES).tolist():
        at = optics.mm_from_px(np.array([1295.5, 971.5]) + rng.uniform(-1.0, 1.0, 2) * (300.0, 100.0))
        pose = commanded(_showing(layout.board if first else held, middle, at, turn_deg, first=first))
        tool = cell.stop(pose)
        there = tool.back() @ layout.board if first else tool @ held
        pixels = render(Scene(60.0, placed(parts.dot_plate(), there)), optics, rng)
        poses.append(pose)
        dots.append(find_dots(pixels, board, mirrored=first).centres_px)
    kind: Kind = "eye_in_hand" if first else "eye_to_hand"
    robot = cell.config.robot
    noise = Noise(robot.repeatability_mm / 3, robot.repeatability_deg / 3)
    found = solve_hand_eye(kind, Looks(poses, np.stack(dots)), board.points_mm, noise)
    return _calibration(name, found.plane_map, found.covariance, found.robot_factor)


def _showing(board: Place, middle: Floats, at: Floats, turn_deg: float, *, first: bool) -> Pose:
    """Where the tool must be, turned like this, for the middle of the board to appear at a point of the plane."""
    turn = Place(0.0, 0.0, turn_deg)
    x, y = board.point(*middle)
    if first:  # the board is fixed in the room, the point in the tool's frame
        away = turn.point(*at)
        return Pose(x - away[0], y - away[1], turn_deg)
    away = turn.point(x, y)  # the board is held, the point in the room
    return Pose(float(at[0]) - away[0], float(at[1]) - away[1], turn_deg)


def _calibration(name: Eye, plane: PlaneMap, covariance: Floats, factor: float) -> CameraCalibration:
    return CameraCalibration(
        schema_version=3,
        made_at=now(),
        camera=name,
        serial="fast",
        view=(0, 0, 2592, 1944),
        mount="tool" if name == "camera-1" else "bench",
        robot_serial="fast",
        robot_controller="fast",
        plane=plane,
        target=Pose(0.0, 0.0, 0.0),
        poses=POSES,
        rotation_spread_deg=25.0,
        rms_px=0.0,
        hold_out_um=0.0,
        predicted_sd_um=0.0,
        predicted_differential_um=0.0,
        robot_factor=factor,
        note="",
        slope_px_per_mm=(0.0, 0.0),
        parameters=tuple(PARAMETERS),
        covariance=tuple(map(tuple, ((covariance + covariance.T) / 2).tolist())),
    )
