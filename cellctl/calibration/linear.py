"""The planar hand-eye problem without lens and without robot noise, solved in closed form."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellctl.calibration.scara import QUARTER, FloatArray, Kind, Setup, rotation

DRAWING_WEIGHT = 1e-3  # 2 mm of the drawing weigh as much as 2 um of the robot


class Linear(NamedTuple):
    """Linear solution. `scale` is the board's pitch over the robot's travel, 1 when both are right."""

    matrix: FloatArray
    offset: FloatArray
    board_mm: FloatArray
    board_rad: float
    scale: float


def linear_start(
    kind: Kind,
    poses: FloatArray,
    dots_px: FloatArray,
    board_mm: FloatArray,
    nominal: tuple[Setup, FloatArray] | None = None,
) -> Linear:
    """Solve for poses (n, 3), dots (n, m, 2) px, nan where a dot is not used, and board points (m, 2).

    Per picture px = L m + d. L is A R(p) turned by the robot, so K = A R(p) is their mean turned back; with it d is
    linear in cos p and sin p, the board's place and the offset. `nominal` (a setup and the picture's centre px) adds
    what is known by drawing as weak equations, so that pictures without rotation can be solved as well.
    """
    middle = board_mm.mean(0)
    fits = grid_fits(dots_px, board_mm - middle)
    turn = poses[:, 2] if kind == "eye_in_hand" else -poses[:, 2]
    common = np.mean(fits[:, :, :2] @ rotation(turn), axis=0)
    rows, right = _linear_rows(kind, poses, common), fits[:, :, 2].reshape(-1)
    if nominal is not None:
        rows, right = _with_nominal(rows, right, common, nominal, middle)
    p_cos, p_sin, *rest = np.linalg.lstsq(rows, right, rcond=None)[0].tolist()
    angle = math.atan2(p_sin, p_cos)
    place = rotation(angle) @ rest[:2] - rotation(angle) @ middle
    return Linear(common @ rotation(-angle), np.array(rest[2:]), place, angle, math.hypot(p_cos, p_sin))


def grid_fits(dots_px: FloatArray, board_mm: FloatArray) -> FloatArray:
    """The even grid next to each picture's dots: px = fit @ (x, y, 1), (n, 2, 3)."""
    design = np.column_stack([board_mm, np.ones(len(board_mm))])
    seen = np.isfinite(dots_px[..., 0])
    fits = [
        np.linalg.lstsq(design[used], dots[used], rcond=None)[0].T for used, dots in zip(seen, dots_px, strict=True)
    ]
    return np.stack(fits)


def _linear_rows(kind: Kind, poses: FloatArray, common: FloatArray) -> FloatArray:
    """Columns: cos p, sin p, the board's middle turned by -p (2), the offset (2); two rows per picture."""
    count = len(poses)
    place = np.stack([poses[:, :2], -poses[:, :2] @ QUARTER.T], axis=-1)  # R(-p) t = place @ (cos p, sin p)
    if kind == "eye_in_hand":
        back = common @ rotation(-poses[:, 2])
        blocks = [-back @ place, back, np.broadcast_to(np.eye(2), (count, 2, 2))]
    else:
        blocks = [common @ place, common @ rotation(poses[:, 2]), np.broadcast_to(np.eye(2), (count, 2, 2))]
    return np.concatenate(blocks, axis=-1).reshape(-1, 6)


def _with_nominal(
    rows: FloatArray, right: FloatArray, common: FloatArray, nominal: tuple[Setup, FloatArray], middle: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Add that the picture's centre looks at the drawn place and that the board lies where drawn, weighted low."""
    setup, picture_centre = nominal
    axis = setup.plane_map.mm_from_px(picture_centre[None])[0]
    board = np.array(setup.board.point(*middle.tolist()))
    looks = np.zeros((2, 6))
    looks[:, :2] = common @ np.column_stack([axis, -QUARTER @ axis])
    looks[:, 4:] = np.eye(2)
    lies = np.zeros((2, 6))
    lies[:, :2] = -np.column_stack([board, -QUARTER @ board])
    lies[:, 2:4] = np.eye(2)
    lies *= 1.0 / setup.plane_map.mm_per_px
    more = np.concatenate([looks, lies]) * DRAWING_WEIGHT
    wanted = np.concatenate([picture_centre, np.zeros(2)]) * DRAWING_WEIGHT
    return np.concatenate([rows, more]), np.concatenate([right, wanted])
