"""What is solved: the robot's pose and the camera's sight of the target, together, many times over.

    eye_in_hand:  camera_from_target = X^-1 robot_from_tool^-1 Z    X = tool_from_camera,   Z = robot_from_target
    eye_to_hand:  camera_from_target = X^-1 robot_from_tool Z       X = robot_from_camera,  Z = tool_from_target

With the arm's motion A between two of them, and the camera's B, that is A X = X B; Z drops out. The paper writes the
first as AX = XB (its eq. 5) and the second as CX = XD (its eq. 9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.six_dof.rigid import FloatArray, inverse

Kind = Literal["eye_in_hand", "eye_to_hand"]
CARRIER: dict[Kind, str] = {"eye_in_hand": "tool", "eye_to_hand": "robot"}  # the frame in which the camera stands still
MOST_MOTIONS = 3000
GOLDEN = 0.6180339887


@dataclass(frozen=True, eq=False)
class Pairs:
    """Robot poses (n, 4, 4) robot_from_tool and sightings (n, 4, 4) camera_from_target, mm; what to call each.

    `swing` (n, 6), where the poses come from a stream: how fast `arm` moves, mm/s and rad/s, seen from outside.
    """

    kind: Kind
    robot: FloatArray
    target: FloatArray
    names: tuple[str, ...]
    swing: FloatArray | None = None

    def __post_init__(self) -> None:
        count = len(self.names)
        if self.robot.shape != (count, 4, 4) or self.target.shape != (count, 4, 4):
            raise ValueError(f"hand-eye: {count} poses, but arrays {self.robot.shape} and {self.target.shape}")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def arm(self) -> FloatArray:
        """The middle factor of the equations above: X^-1 `arm` Z is what the camera sees."""
        return inverse(self.robot) if self.kind == "eye_in_hand" else self.robot

    def only(self, keep: Sequence[int] | NDArray[np.intp]) -> Pairs:
        """Some of them."""
        index = np.asarray(keep, np.intp)
        swing = None if self.swing is None else self.swing[index]
        names = tuple(self.names[i] for i in index.tolist())
        return replace(self, robot=self.robot[index], target=self.target[index], names=names, swing=swing)


def motion_indices(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which two poses make a motion: all of them, or an even choice of some thousand."""
    if count * (count - 1) // 2 <= MOST_MOTIONS:
        first, second = np.triu_indices(count, 1)
        return first.astype(np.intp), second.astype(np.intp)
    strides = {round(count * (k * GOLDEN % 1.0)) % count for k in range(1, MOST_MOTIONS // count + 2)} - {0}
    first = np.tile(np.arange(count, dtype=np.intp), len(strides))
    second = (first + np.repeat(np.array(sorted(strides), np.intp), count)) % count
    return first, np.asarray(second, np.intp)


def motions(poses: FloatArray, indices: tuple[NDArray[np.intp], NDArray[np.intp]]) -> FloatArray:
    """The motions (k, 4, 4) between two of the poses each, seen from the frame in which they are given."""
    first, second = indices
    return np.asarray(poses[first] @ inverse(poses[second]), np.float64)
