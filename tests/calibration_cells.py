"""Cells whose truth the test knows, seen by an exact forward model that is written with poses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from cellctl.calibration.board import DotBoard
from cellctl.calibration.hand_eye import HandEye, solve_hand_eye
from cellctl.calibration.plan import Plan, PlanRequest, Task, plan_hand_eye
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.problem import Looks
from cellctl.calibration.scara import Kind, Noise, Setup
from cellctl.calibration.view import drawn_setup
from cellctl.geometry import Pose
from cellctl.mount import Mount, Stop

Case = Literal["eye_in_hand", "eye_to_hand", "arm_2"]

BOARD = DotBoard()
PICTURE = (2592, 1944)
CENTRE = np.array([1295.5, 971.5])
PX_PER_MM = 1000 / (2.2 / 0.3)
KINDS: tuple[Kind, Kind] = ("eye_in_hand", "eye_to_hand")
CASES: tuple[Case, ...] = ("eye_in_hand", "eye_to_hand", "arm_2")
QUIET = Noise(1e-9, 1e-9, 1e-9)
STATED = Noise()
CAMERA = {"eye_in_hand": Pose(55, 0, 0), "eye_to_hand": Pose(300, -120, 0), "arm_2": Pose(55, 0, -70)}
BOARD_AT = {"eye_in_hand": Pose(340, -20, 0), "eye_to_hand": Pose(-4.8, -3.6, 0), "arm_2": Pose(340, -20, -24)}
TOOL, ARM_2 = Mount("tool", 225.0, 175.0, "righty"), Mount("arm_2", 225.0, 175.0, "righty")


@dataclass(frozen=True, eq=False)
class Cell:
    """A cell as it truly is."""

    case: Case
    camera: PlaneMap
    board: Pose
    axis_mm: np.ndarray
    slope_px_per_mm: np.ndarray

    @property
    def kind(self) -> Kind:
        return "eye_to_hand" if self.case == "eye_to_hand" else "eye_in_hand"

    @property
    def mount(self) -> Mount:
        return ARM_2 if self.case == "arm_2" else TOOL

    @property
    def setup(self) -> Setup:
        return Setup(self.kind, self.camera, self.board)

    def see(self, stops: Sequence[Stop | Pose], rng, noise=STATED, below_mm: Sequence[float] = ()) -> np.ndarray:
        """Dots (n, m, 2) px of pictures taken at stops that the robot reaches only to its repeatability."""
        pictures = []
        for number, at in enumerate(stops):
            pose, elbow = at if isinstance(at, Stop) else (at, "righty")
            dx, dy, dt = rng.normal(0, (noise.robot_sd_mm, noise.robot_sd_mm, noise.robot_sd_deg))
            true = Pose(pose.x_mm + dx, pose.y_mm + dy, pose.t_deg + dt)
            mount = self.mount.frame(true, elbow)
            plane = true @ self.board if self.kind == "eye_to_hand" else mount.inverse() @ self.board
            dots = self.camera.px_from_mm([plane.point(*point) for point in BOARD.points_mm.tolist()])
            pictures.append(dots + (self.slope_px_per_mm * below_mm[number] if len(below_mm) else 0.0))
        return np.array(pictures) + rng.normal(0, noise.dot_sd_px, (len(pictures), BOARD.count, 2))

    def error_um(self, camera: PlaneMap, offsets_mm) -> np.ndarray:
        """Length of the map's error at points around the camera's axis."""
        points = self.axis_mm + offsets_mm
        return np.hypot(*(camera.mm_from_px(self.camera.px_from_mm(points)) - points).T) * 1000


@cache
def true_cell(case: Case, seed: int) -> Cell:
    """Mounts off by 1.5 mm and 3 degrees, a lens within its tolerance."""
    rng = np.random.default_rng([seed, CASES.index(case)])
    turn, tilt_x, tilt_y = np.radians([rng.uniform(-3, 3) - CAMERA[case].t_deg, *rng.normal(0, 0.4, 2)])
    view = np.eye(2) if case == "eye_to_hand" else np.diag([1.0, -1.0])
    tilt = np.array([[math.cos(tilt_x), 0], [math.sin(tilt_x) * math.sin(tilt_y), math.cos(tilt_y)]])
    nearer = np.array([math.sin(tilt_x), -math.cos(tilt_x) * math.sin(tilt_y)])
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    scaled = PX_PER_MM * (1 + rng.normal(0, 5e-4)) * view @ turned
    axis = np.array(CAMERA[case][:2]) + rng.uniform(-1.5, 1.5, 2)
    k1, lens_centre = rng.uniform(-3e-10, 3e-10), CENTRE + rng.normal(0, 60, 2)
    at = BOARD_AT[case]
    board = Pose(at.x_mm + rng.uniform(-1, 1), at.y_mm + rng.uniform(-1, 1), at.t_deg + rng.uniform(-3, 3))
    matrix = scaled @ tilt
    camera = PlaneMap.from_arrays(matrix, CENTRE - matrix @ axis, k1, lens_centre)
    return Cell(case, camera, board, axis, scaled @ nearer)


def drawn(case: Case) -> Setup:
    hand = case != "eye_to_hand"
    return drawn_setup(
        "eye_in_hand" if hand else "eye_to_hand",
        camera=CAMERA[case],
        mirrored=hand,
        px_per_mm=PX_PER_MM,
        board=BOARD_AT[case],
        picture_px=PICTURE,
    )


def anywhere(stop: Stop) -> bool:
    return True


def task(setup: Setup, mount: Mount = TOOL, **changes) -> Task:
    known = {"board": BOARD, "picture_px": PICTURE, "mount": mount, "reaches": anywhere}
    return Task(setup, **{**known, **changes})


@cache
def plan(cell: Cell, **wishes) -> Plan:
    return plan_hand_eye(task(cell.setup, cell.mount), PlanRequest(margin_mm=0.3, **wishes))


def planned(cell: Cell, **wishes) -> tuple[Pose, ...]:
    """Poses of the tool; for the two cases in which they are the mount's as well."""
    return plan(cell, **wishes).poses


def calibrated(cell: Cell, seed: int = 0, noise: Noise = STATED, **wishes) -> HandEye:
    found = plan(cell, **wishes)
    dots = cell.see(found.stops, np.random.default_rng(seed), noise)
    scatter = cell.mount.scatter(found.stops, STATED.robot_sd_mm, STATED.robot_sd_deg)
    return solve_hand_eye(cell.kind, Looks(found.poses, dots, None, scatter), BOARD.points_mm)


def solved(kind: Kind, poses: Sequence[Pose], dots: np.ndarray, board_mm: np.ndarray = BOARD.points_mm) -> HandEye:
    return solve_hand_eye(kind, Looks(poses, dots), board_mm)


def differential_um(cell: Cell, camera: PlaneMap, rng) -> np.ndarray:
    """A feature of a part that moved by +-1 mm and +-1.5 deg, turned back about the tool: error of its travel."""
    taught = cell.axis_mm + np.array([5, 3])
    moves, turns = rng.uniform(-1, 1, (100, 2)), np.radians(rng.uniform(-1.5, 1.5, 100))
    at = camera.mm_from_px(cell.camera.px_from_mm(taught[None]))[0]
    wrong = camera.mm_from_px(cell.camera.px_from_mm(taught + moves)) - (taught + moves)
    c, s = np.cos(turns) - 1, np.sin(turns)
    lever = np.stack([c * wrong[:, 0] - s * wrong[:, 1], s * wrong[:, 0] + c * wrong[:, 1]], -1)
    return np.hypot(*(wrong - (at - taught) + lever).T) * 1000
