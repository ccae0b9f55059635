"""What a robot's motion can tell about its camera, and what not, in words: from the robot's poses alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellctl.calibration.errors import DegenerateMotion
from cellctl.calibration.six_dof.pairs import CARRIER, Kind
from cellctl.calibration.six_dof.rigid import FloatArray, inverse, nearest_rotation, vector_from_rotation

LEAST_POSES = 3
LEAST_TURN_DEG = 10.0
LEAST_ACROSS_DEG = 5.0
LEAST_TRAVEL_MM = 5.0  # apart from turning about one line
STRAIGHT_DEG = 3.0  # a direction this near to an axis is called by its name
AXES = "xyz"


class Turns(NamedTuple):
    """How far the arm turns about three directions of the camera's carrier, most to least."""

    spread_deg: tuple[float, float, float]
    directions: FloatArray  # (3, 3), one per row
    carrier: str  # the frame of the directions

    @property
    def axis(self) -> str:
        """The direction of most rotation, in words."""
        return direction_text(self.directions[0], self.carrier)


def arm_turns(kind: Kind, robot: FloatArray) -> Turns:
    """The rotations of the arm's poses (n, 4, 4) about their mean, as spreads about their principal directions."""
    turns = (inverse(robot) if kind == "eye_in_hand" else robot)[:, :3, :3]
    about = vector_from_rotation(turns @ nearest_rotation(turns.mean(0)).T)
    centred = about - about.mean(0)
    directions = np.linalg.svd(np.vstack([centred, np.zeros((3, 3))]), full_matrices=False)[2]
    widest, second, third = np.degrees(np.ptp(centred @ directions.T, axis=0)).tolist()
    return Turns((widest, second, third), _outwards(directions), CARRIER[kind])


def check_freedom(kind: Kind, robot: FloatArray, *, along_axis_known: bool = False) -> Turns:
    """Raise DegenerateMotion when these poses (n, 4, 4) cannot tell where the camera is, naming what stays unknown.

    `along_axis_known`: the camera's place along a single axis of rotation is given, which is all that one axis
    leaves open as long as the tool also travels across it.
    """
    if len(robot) < LEAST_POSES:
        raise DegenerateMotion(
            "pose count", f"{len(robot)} poses are given, at least {LEAST_POSES} are needed and 15 are good: take more"
        )
    turns = arm_turns(kind, robot)
    most, across, _ = turns.spread_deg
    if most < LEAST_TURN_DEG:
        raise DegenerateMotion(
            "no rotation",
            f"the tool turns by {most:.2f} deg in all, at least {LEAST_TURN_DEG:g} deg are needed: without rotation "
            "the camera's place cannot be found in any direction, only how it is turned; turn the tool by 30 deg or "
            "more about two directions",
        )
    if across < LEAST_ACROSS_DEG and not along_axis_known:
        raise DegenerateMotion(
            "one axis of rotation",
            f"the tool turns by {most:.1f} deg about {turns.axis} and by {across:.2f} deg about every other direction, "
            f"at least {LEAST_ACROSS_DEG:g} deg are needed: the camera's place along {turns.axis} cannot be found; "
            "tilt the tool, or, for a SCARA, which cannot, measure that one number and give it (--along-axis-mm)",
        )
    if across < LEAST_ACROSS_DEG:
        _check_travel(robot, turns)
    return turns


def _check_travel(robot: FloatArray, turns: Turns) -> None:
    """About one axis only, and never off one line: then the camera's turn about that axis is not seen either."""
    place, turn = robot[:, :3, 3], robot[:, :3, :3]
    rows = np.concatenate([np.broadcast_to(np.eye(3), turn.shape), turn], axis=2).reshape(-1, 6)
    turning = rows @ np.linalg.lstsq(rows, place.reshape(-1), rcond=1e-9)[0]
    travel_mm = float(np.linalg.norm(np.ptp(place - turning.reshape(-1, 3), axis=0)))
    if travel_mm < LEAST_TRAVEL_MM:
        raise DegenerateMotion(
            "travel",
            f"the tool turns about {turns.axis} only and, apart from turning, travels by {travel_mm:.2f} mm: how the "
            f"camera is turned about that axis cannot be found; let the tool travel by {LEAST_TRAVEL_MM:g} mm or more",
        )


def amplification(kind: Kind, robot: FloatArray) -> FloatArray:
    """What 1 mm of noise in every sighting does to the camera's place along the directions of `arm_turns`, (3,) mm.

    Each pose says where the target is as a turned camera place plus what is seen; with the target eliminated the
    information is n (I - S S'), S the mean of the arm's rotations. Along a single axis of rotation it is none.
    """
    turns = arm_turns(kind, robot)
    mean = (inverse(robot) if kind == "eye_in_hand" else robot)[:, :3, :3].mean(0)
    information = len(robot) * (np.eye(3) - mean @ mean.T)
    spread = np.linalg.inv(information + np.eye(3) * 1e-12)
    along = np.einsum("ki,ij,kj->k", turns.directions, spread, turns.directions)
    return np.asarray(np.sqrt(np.maximum(along, 0.0)), np.float64)


def direction_text(direction: FloatArray, frame: str) -> str:
    """A direction of a frame by its axis' name, or by its three parts."""
    nearest = int(np.argmax(np.abs(direction)))
    if abs(direction[nearest]) >= np.cos(np.radians(STRAIGHT_DEG)) * np.linalg.norm(direction):
        return f"the {AXES[nearest]} axis of the {frame} frame"
    parts = ", ".join(f"{part:+.2f}" for part in direction.tolist())
    return f"the direction ({parts}) of the {frame} frame"


def _outwards(directions: FloatArray) -> FloatArray:
    """The same directions with their largest part positive."""
    largest = np.take_along_axis(directions, np.abs(directions).argmax(1)[:, None], axis=1)
    return np.asarray(directions * np.where(largest < 0, -1.0, 1.0), np.float64)
