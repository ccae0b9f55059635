"""Robots that turn in space, with a camera whose place the test knows; and the real arm's two files, if there."""

import zipfile
from pathlib import Path

import numpy as np

from cellctl.calibration.six_dof.pairs import Kind, Pairs
from cellctl.calibration.six_dof.rigid import FloatArray, inverse, rigid, rotation_from_vector

ROOT = Path(__file__).resolve().parent.parent
REAL = ROOT.parent / "shared" / "data" / "handeye" / "robot_arm_w_color_camera_real.zip"
PARTS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
ROBOT_SD = (0.0033, 0.0017)  # mm, deg
SEEN_SD_MM, SEEN_SD_DEG = np.array([0.002, 0.002, 0.03]), 0.02


def truth(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Where the camera is on its carrier, and the target on its own."""
    camera = rigid(_turn(rng, 60), rng.uniform(-60, 60, 3))
    target = rigid(_turn(rng, 100), rng.uniform(-10, 10, 3) + np.array([300, 0, 0]))
    return camera, target


def looks(rng: np.random.Generator, kind: Kind, count: int = 15, tilt_deg: float = 20.0, noise: float = 1.0):
    """X, Z and what a robot and its camera report: the target some 110 mm away, turned this way and that."""
    camera, target = truth(rng)
    turns = np.radians(rng.uniform(-1, 1, (count, 3)) * (tilt_deg, tilt_deg, 30))
    seen = rigid(rotation_from_vector(turns), rng.uniform(-1, 1, (count, 3)) * (3, 3, 5) + (0, 0, 110))
    arm = camera @ seen @ inverse(target)
    robot = inverse(arm) if kind == "eye_in_hand" else arm
    robot = robot @ _noise(rng, count, ROBOT_SD[0] * noise, ROBOT_SD[1] * noise)
    off = _noise(rng, count, SEEN_SD_MM * noise, SEEN_SD_DEG * noise)
    reported = seen.copy()
    reported[:, :3, :3] = off[:, :3, :3] @ seen[:, :3, :3]
    reported[:, :3, 3] += off[:, :3, 3]
    return camera, target, Pairs(kind, robot, reported, tuple(f"row {i}" for i in range(1, count + 1)))


def real_tables(folder: Path) -> tuple[Path, Path]:
    """The real arm's streams with a header on top: what anybody with such files would write."""
    files = []
    with zipfile.ZipFile(REAL) as archive:
        for end, frame in (("hinge.csv", "robot_from_tool"), ("target_ir.csv", "target_from_camera")):
            name = next(name for name in archive.namelist() if name.endswith(end))
            header = ",".join(["time_s", *(f"{frame}.{part}" for part in PARTS)])
            files.append(folder / f"{frame}.csv")
            files[-1].write_text(f"# a real arm\n{header}\n{archive.read(name).decode()}", encoding="utf-8")
    return files[0], files[1]


def _turn(rng: np.random.Generator, most_deg: float) -> FloatArray:
    return rotation_from_vector(np.radians(rng.uniform(-1, 1, 3) * most_deg))


def _noise(rng: np.random.Generator, count: int, sd_mm: float | FloatArray, sd_deg: float) -> FloatArray:
    turns = rotation_from_vector(rng.normal(0, np.radians(sd_deg), (count, 3)))
    return rigid(turns, rng.normal(0, 1, (count, 3)) * sd_mm)
