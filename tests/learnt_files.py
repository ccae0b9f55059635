"""Calibrations and golden assemblies as files, for tests: believable figures, every one of them may be changed."""

from typing import Any

import numpy as np

from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Pose, Px
from cellctl.learnt.calibrations import CameraCalibration, ToolFigures
from cellctl.learnt.references import now
from cellctl.learnt.taught import Taught

PLANE = PlaneMap(((136.0, 0.0), (0.0, -136.0)), (1300.0, 970.0), 0.0, (1295.5, 971.5))
PARAMETERS = ("a11", "a12", "a21", "a22", "offset_u_px", "offset_v_px")
COVARIANCE = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 0.25, 0.25])
TOOL = ToolFigures(
    centre_px=Px(1290.0, 970.0),
    map_dx_um=3.0,
    map_dy_um=-2.0,
    centre_covariance_um2=((3.0, 0.1), (0.1, 3.0)),
    eccentricity_mm=(0.3, -0.1),
    eccentricity_covariance_um2=((3.0, 0.0), (0.0, 3.0)),
    wobble_rms_um=4.0,
    wobble_worst_um=7.0,
)


def rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def calibration(**changed: Any) -> CameraCalibration:
    values = {
        "made_at": now(),
        "camera": "camera-1",
        "serial": "SIM-CAM-1",
        "view": (0, 0, 2592, 1944),
        "mount": "tool",
        "robot_serial": "SIM-ROBOT",
        "robot_controller": "RCX340 V1.20,R0000, YK400XG",
        "plane": PLANE,
        "target": Pose(1.0, 2.0, 3.0),
        "poses": 15,
        "rotation_spread_deg": 58.0,
        "rms_px": 0.005,
        "hold_out_um": 5.0,
        "predicted_sd_um": 3.0,
        "predicted_differential_um": 0.5,
        "slope_px_per_mm": (0.1, -0.2),
        "robot_factor": 1.0,
        "note": "z is not observable",
        "parameters": PARAMETERS,
        "covariance": rows(COVARIANCE),
    }
    return CameraCalibration(**(values | changed))


def taught(**changed: Any) -> Taught:
    here = Pose(0.0, 0.0, 0.0)
    places = ("look_1", "look_2", "robot_from_base", "base_from_battery", "tool_from_battery", "table_pick")
    values = {
        "made_at": now(),
        "recipe": "x85",
        "geometry": "0" * 12,
        "calibrations": ("a", "b"),
        "robot_from_battery_on_table": here,
        "repeats": 5,
        "pairs": 2,
        "spread_mm": 0.006,
        "spread_deg": 0.002,
        "between_mm": 0.004,
        "between_deg": 0.001,
        **dict.fromkeys(places, here),
    }
    return Taught(**(values | changed))
