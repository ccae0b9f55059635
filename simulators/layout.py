"""Where things are bolted down: the drawing of the cell, and how far one real cell deviates from it.

Robot coordinates: mm, degrees, Z positive down. A seed makes one believable cell: mounts are off by up to 2 mm and
3 degrees, benches by half a millimetre, lenses by their tolerance. Nobody outside this package is told how far.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulators.place import Place
from simulators.render import Optics

PX_PER_MM = 1000.0 / (2.2 / 0.3)  # 2.2 um pixels behind a 0.3x telecentric lens
IMAGE_CENTRE_PX = np.array([1295.5, 971.5])
DOWN = np.diag([1.0, -1.0])  # camera 1 looks down: the picture is mirrored in v against the robot's Y
UP = np.eye(2)  # camera 2 looks up: u along X, v along Y


Carrier = Literal["tool", "arm_2"]
# What carries camera 1: how its picture lies on it, and the dot board so that the camera sees all of it when turned.
TURNED_DEG: dict[Carrier, float] = {"tool": 0.0, "arm_2": -70.0}
BOARD_DEG: dict[Carrier, float] = {"tool": 0.0, "arm_2": -24.0}


@dataclass(frozen=True)
class Heights:
    """Robot Z at which things meet, mm, positive down."""

    table_mm: float = 110.0  # cup on a battery on the table
    seat_mm: float = 100.0  # cup on a battery in its seat
    nest_mm: float = 105.0  # cup on the dot plate
    reject_mm: float = 100.0  # cup holding a battery just above the reject tray
    camera_1_mm: float = 60.0  # camera 1 in focus
    camera_2_mm: float = 60.0  # part in the focus of camera 2


@dataclass(frozen=True)
class Layout:
    """One cell as it truly stands."""

    station: Place  # base frame of a base that lies exactly as the carrier should hold it
    table: Place  # battery frame of a battery that lies exactly as it should
    board: Place  # large dot of the fixed dot board, looked at by camera 1
    nest: Place  # large dot of the dot plate while it lies in its nest
    reject: Place
    carrier: Carrier  # of camera 1
    camera_1: Optics  # millimetres in the frame of its carrier
    camera_2: Optics  # millimetres in the robot frame
    heights: Heights


def build_layout(rng: np.random.Generator, carrier: Carrier = "tool") -> Layout:
    """A cell bolted together by people with a ruler."""
    return Layout(
        station=_near(rng, 282.0, 120.0, 0.0),
        table=_near(rng, 200.0, -220.0, 0.0),
        board=_near(rng, 340.0, -20.0, BOARD_DEG[carrier]),
        nest=_near(rng, 150.0, 250.0, 0.0),
        reject=_near(rng, 100.0, 260.0, 0.0),
        carrier=carrier,
        camera_1=_optics(rng, DOWN, (55.0, 0.0), TURNED_DEG[carrier]),
        camera_2=_optics(rng, UP, (300.0, -120.0), 0.0),
        heights=Heights(),
    )


def _near(rng: np.random.Generator, x_mm: float, y_mm: float, t_deg: float) -> Place:
    dx, dy = rng.uniform(-0.4, 0.4, 2)
    return Place(x_mm + float(dx), y_mm + float(dy), t_deg + float(rng.uniform(-0.3, 0.3)))


def _optics(
    rng: np.random.Generator, view: NDArray[np.float64], axis_mm: tuple[float, float], turned_deg: float
) -> Optics:
    """A telecentric camera: scale, mount rotation, tilt, distortion and its centre drawn within tolerance.

    `turned_deg` is how its u axis is meant to lie on its mount.
    """
    turn = math.radians(rng.uniform(-3.0, 3.0) - turned_deg)
    tilt_x, tilt_y = np.radians(rng.normal(0.0, 0.4, 2))
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    tilt = np.array([[math.cos(tilt_x), 0.0], [math.sin(tilt_x) * math.sin(tilt_y), math.cos(tilt_y)]])
    matrix = PX_PER_MM * (1.0 + rng.normal(0.0, 5e-4)) * view @ rotation @ tilt
    nearer = np.array([math.sin(tilt_x), -math.cos(tilt_x) * math.sin(tilt_y)])  # third column of the same rotation
    lean_x, lean_y = np.linalg.solve(tilt, nearer).tolist()
    axis = np.array(axis_mm) + rng.uniform(-1.5, 1.5, 2)
    return Optics(
        matrix=matrix,
        offset_px=IMAGE_CENTRE_PX - matrix @ axis,
        k1=float(rng.uniform(-1.0, 1.0)) * 0.0008 / 1620.0**2,
        centre_px=IMAGE_CENTRE_PX + rng.normal(0.0, 60.0, 2),
        blur_px=float(rng.uniform(0.9, 1.3)),
        lean=(lean_x, lean_y),
    )
