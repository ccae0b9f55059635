"""Pictures of the dot board by a camera that may have moved, from a robot that misses by its repeatability."""

import numpy as np

from cellctl.calibration.board import DotBoard
from cellctl.calibration.hysteresis import APPROACHES, Approach
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import Kind, Noise, Setup
from cellctl.calibration.verification import Verification, verify
from cellctl.geometry import Mm, Offset, Pose, turned_about

BOARD = DotBoard()
PICTURE = (2592, 1944)
NOISE = Noise(0.01 / 3, 0.004 / 3, 0.01)
DOWN = PlaneMap(((136.4, 2.0), (2.0, -136.4)), (1295.0 - 136.4 * 55, 971.0 - 2.0 * 55), -2e-10, (1290.0, 975.0))
UP = PlaneMap(
    ((136.2, -1.0), (1.0, 136.2)), (1295.0 - 136.2 * 300 - 120, 971.0 - 300 + 136.2 * 120), 1e-10, (1295.0, 971.0)
)
FIXED, HELD = Pose(340.2, -20.3, 0.4), Pose(-4.9, -3.5, 0.2)
MOVES = [(-2.0, 1.0, -30.0), (1.5, -1.0, -18.0), (-1.0, -1.5, 2.0), (2.0, 1.5, 16.0), (0.5, -0.5, 30.0)]
WIDE = [
    (0.3, 0.2, -50.0),
    (-0.5, -0.3, -40.0),
    (1.5, 0.5, -25.0),
    (-3.5, 2.2, -8.0),
    (3.8, -2.4, 0.0),
    (-3.8, -2.3, 5.0),
    (2.8, 1.6, 15.0),
    (-0.8, -0.4, 40.0),
    (0.4, -0.2, 50.0),
]


def setup_of(kind: Kind) -> Setup:
    return Setup(kind, DOWN, FIXED) if kind == "eye_in_hand" else Setup(kind, UP, HELD)


def poses_of(kind: Kind) -> list[Pose]:
    """Poses that show the board's middle near the picture's middle."""
    middle = Mm(*BOARD.centre_mm.tolist())
    if kind == "eye_in_hand":
        there = FIXED.point(*middle)
        poses = []
        for x, y, t in MOVES:
            away = Pose(0, 0, t).point(55 + x, y)
            poses.append(Pose(there.x_mm - away.x_mm, there.y_mm - away.y_mm, t))
        return poses
    poses = []
    for x, y, t in WIDE:
        grip = Pose(0, 0, t) @ HELD
        at = grip.point(*middle)
        poses.append(Pose(300 + x - at.x_mm, -120 + y - at.y_mm, t))
    return poses


def moved_camera(kind: Kind, shift: Offset) -> Pose:
    """The camera's rigid motion in its mount's frame, about the place that the picture's middle shows."""
    setup = setup_of(kind)
    u, v = (PICTURE[0] - 1) / 2, (PICTURE[1] - 1) / 2
    x_mm, y_mm = setup.plane_map.mm_from_px([[u, v]])[0].tolist()
    return turned_about(Mm(x_mm, y_mm), shift)


def see(
    kind: Kind, camera: Pose, rng: np.random.Generator, *, noise: float = 1.0, board: Pose | None = None
) -> np.ndarray:
    """Dots at all poses when the camera has moved by `camera`, the robot misses by its repeatability."""
    setup, seen = setup_of(kind), []
    board = board or setup.board
    for pose in poses_of(kind):
        dx, dy, dt = (rng.normal(0.0, 1.0, 3) * noise).tolist()
        true = Pose(
            pose.x_mm + dx * NOISE.robot_sd_mm, pose.y_mm + dy * NOISE.robot_sd_mm, pose.t_deg + dt * NOISE.robot_sd_deg
        )
        in_frame = true.inverse() @ board if kind == "eye_in_hand" else true @ board
        in_map = camera.inverse() @ in_frame
        points = np.array([in_map.point(*point) for point in BOARD.points_mm.tolist()])
        dots = setup.plane_map.px_from_mm(points)
        seen.append(dots + rng.normal(0.0, NOISE.dot_sd_px * noise, dots.shape))
    return np.stack(seen)


def verified(kind: Kind, dots: np.ndarray) -> Verification:
    return verify(setup_of(kind), poses_of(kind), dots, BOARD.points_mm, PICTURE, NOISE)


def stops(rng: np.random.Generator, repeats: int, lag: np.ndarray) -> tuple[list[Approach], np.ndarray]:
    """Stops that lag behind by so much (mm, mm, deg) in each coordinate, on the side they came from."""
    order = [approach for _ in range(repeats) for approach in APPROACHES]
    noise = rng.normal(0.0, [NOISE.robot_sd_mm, NOISE.robot_sd_mm, NOISE.robot_sd_deg], (len(order), 3))
    return order, np.array(order) * lag + noise + np.array([285.0, -20.0, 0.0])


def turned_plate(rng: np.random.Generator) -> tuple[list[Pose], np.ndarray, Mm]:
    """Nine pure rotations of a held plate over camera 2: poses, dots, and the plate's middle about the R axis."""
    poses = [Pose(300.0, -120.0, turn_deg) for turn_deg in range(-60, 61, 15)]
    middle = Mm(*BOARD.centre_mm.tolist())
    grip = Pose(0.3 - middle.x_mm, -0.2 - middle.y_mm, 0.0)
    seen = []
    for pose in poses:
        dx, dy, dt = rng.normal(0.0, [NOISE.robot_sd_mm, NOISE.robot_sd_mm, NOISE.robot_sd_deg]).tolist()
        held = Pose(pose.x_mm + dx, pose.y_mm + dy, pose.t_deg + dt) @ grip
        points = np.array([held.point(*point) for point in BOARD.points_mm.tolist()])
        seen.append(UP.px_from_mm(points) + rng.normal(0.0, NOISE.dot_sd_px, (len(points), 2)))
    return poses, np.stack(seen), grip.point(*middle)
