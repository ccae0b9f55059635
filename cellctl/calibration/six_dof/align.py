"""Tables to pairs: row by row, or two streams with clocks of their own brought to one time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellctl.calibration.errors import PosesDisagree, UnreadablePoses
from cellctl.calibration.six_dof.pairs import Kind, Pairs
from cellctl.calibration.six_dof.rigid import (
    FloatArray,
    inverse,
    rigid,
    rotation_from_vector,
    vector_from_rotation,
)
from cellctl.calibration.six_dof.table import Frame, Table

MOST_DELAY_S = 2.0
DELAY_STEP_S = 0.005
LEAST_WINDOW_S = 0.4  # turning is compared over so much to either side, since sightings are noisy
LEAST_ROWS = 10
LEAST_LIKENESS = 0.5  # correlation of the two streams' turning
MOST_GAP_S = 0.25  # no pose is made up across a longer gap of the robot's stream


class Delay(NamedTuple):
    """By how much the robot's clock is ahead: its pose at `t + robot_ahead_s` belongs to a sighting at t."""

    robot_ahead_s: float
    likeness: float  # correlation of the two streams' turning there; 1 is perfect


@dataclass(frozen=True, eq=False)
class Stream:
    """Poses (n, 4, 4) at growing times (n,)."""

    time_s: FloatArray
    poses: FloatArray

    def at(self, time_s: FloatArray) -> FloatArray:
        """The poses (m, 4, 4) at these times, straight and evenly turning in between; held beyond the ends."""
        after = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        start, end = self.poses[after - 1], self.poses[after]
        span_s = self.time_s[after] - self.time_s[after - 1]
        share = np.clip((time_s - self.time_s[after - 1]) / span_s, 0.0, 1.0)[:, None]
        turn = vector_from_rotation(start[:, :3, :3].transpose(0, 2, 1) @ end[:, :3, :3]) * share
        place = start[:, :3, 3] + (end[:, :3, 3] - start[:, :3, 3]) * share
        return rigid(start[:, :3, :3] @ rotation_from_vector(turn), place)

    def turned(self, time_s: FloatArray, window_s: float) -> FloatArray:
        """By how much (m,) rad it turns from `window_s` before to `window_s` after these times."""
        before, after = self.at(time_s - window_s)[:, :3, :3], self.at(time_s + window_s)[:, :3, :3]
        return np.asarray(np.linalg.norm(vector_from_rotation(before.transpose(0, 2, 1) @ after), axis=1), np.float64)

    def covers(self, time_s: FloatArray) -> FloatArray:
        """Which of these times lie inside and in no gap, as booleans (m,)."""
        after = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        inside = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        return np.asarray(inside & (self.time_s[after] - self.time_s[after - 1] <= MOST_GAP_S), np.bool_)


def pairs_in_one(kind: Kind, table: Table) -> Pairs:
    """Each row has both poses of one moment. Raises UnreadablePoses when one is missing."""
    robot, target = (_poses(table, frame) for frame in ("robot_from_tool", "camera_from_target"))
    return Pairs(kind, robot, target, tuple(f"{table.name}:{line}" for line in table.lines))


def streams(first: Table, second: Table) -> tuple[Stream, Stream]:
    """The robot's stream and the camera's out of two tables, in either order. Raises UnreadablePoses."""
    if "robot_from_tool" not in first.poses:
        first, second = second, first
    return _stream(first, "robot_from_tool"), _stream(second, "camera_from_target")


def estimate_delay(robot: Stream, camera: Stream) -> Delay:
    """How much the clocks differ, from how fast both turn: that is the same whatever the hand-eye is.

    Raises PosesDisagree when the streams do not turn alike at any delay.
    """
    step_s = float(np.median(np.diff(camera.time_s)))
    window_s = max(LEAST_WINDOW_S, 3 * step_s)
    seen = camera.turned(camera.time_s, window_s)
    grid_s = np.arange(robot.time_s[0], robot.time_s[-1], DELAY_STEP_S)
    turned = robot.turned(grid_s, window_s)
    delays_s = np.arange(-MOST_DELAY_S, MOST_DELAY_S + DELAY_STEP_S / 2, DELAY_STEP_S)
    alike = np.array([_likeness(robot, camera, float(d), window_s, (grid_s, turned), seen) for d in delays_s])
    best = int(alike.argmax())
    if not alike[best] >= LEAST_LIKENESS:
        raise PosesDisagree(
            "time",
            f"robot and camera do not turn alike at any delay up to {MOST_DELAY_S:g} s (correlation "
            f"{float(alike[best]):.2f}): check that both files are of the same run and that time_s is in seconds",
        )
    return Delay(float(delays_s[best]) + DELAY_STEP_S * _vertex(alike, best), float(alike[best]))


def pairs_in_time(kind: Kind, robot: Stream, camera: Table, robot_ahead_s: float) -> Pairs:
    """Every sighting with the robot's pose at its time; sightings outside the robot's stream are not used."""
    seen = _stream(camera, "camera_from_target")
    at_s = seen.time_s + robot_ahead_s
    inside = np.flatnonzero(robot.covers(at_s))
    if len(inside) < LEAST_ROWS:
        raise PosesDisagree(
            "time",
            f"{len(inside)} of {len(at_s)} sightings fall into the time of the robot's poses: check that both files "
            "are of the same run",
        )
    at_s = at_s[inside]
    pairs = Pairs(
        kind, robot.at(at_s), seen.poses[inside], tuple(f"{camera.name}:{camera.lines[i]}" for i in inside.tolist())
    )
    step_s = float(np.median(np.diff(robot.time_s)))
    before, after = (Pairs(kind, robot.at(at_s + sign * step_s), pairs.target, pairs.names).arm for sign in (-1, 1))
    change = after @ inverse(before)
    spin = vector_from_rotation(change[:, :3, :3]) / (2 * step_s)
    swing = np.concatenate([change[:, :3, 3] / (2 * step_s), spin], axis=1)
    return Pairs(kind, pairs.robot, pairs.target, pairs.names, swing)


def _likeness(
    robot: Stream,
    camera: Stream,
    delay_s: float,
    window_s: float,
    turned: tuple[FloatArray, FloatArray],
    seen: FloatArray,
) -> float:
    """Correlation of the turning at one delay, over what both streams cover; -1 for too little."""
    at_s, inset_s = camera.time_s + delay_s, window_s
    both = (at_s >= robot.time_s[0] + inset_s) & (at_s <= robot.time_s[-1] - inset_s)
    both &= (camera.time_s >= camera.time_s[0] + inset_s) & (camera.time_s <= camera.time_s[-1] - inset_s)
    if both.sum() < max(LEAST_ROWS, 0.3 * len(at_s)):
        return -1.0
    a, b = np.interp(at_s[both], *turned), seen[both]
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else -1.0


def _vertex(values: FloatArray, best: int) -> float:
    """Where between its neighbours a maximum lies, by a parabola, in steps."""
    if not 0 < best < len(values) - 1:
        return 0.0
    left, top, right = values[best - 1 : best + 2].tolist()
    bend = left - 2 * top + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0


def _poses(table: Table, frame: Frame) -> FloatArray:
    if frame not in table.poses:
        raise UnreadablePoses(table.name, f"there are no columns {frame}.* (or of its inverse)")
    return table.poses[frame]


def _stream(table: Table, frame: Frame) -> Stream:
    poses = _poses(table, frame)
    if table.time_s is None:
        raise UnreadablePoses(table.name, "two files can only be brought together by a column time_s in both")
    if len(poses) < LEAST_ROWS:
        raise UnreadablePoses(table.name, f"{len(poses)} rows are no stream, at least {LEAST_ROWS} are needed")
    return Stream(table.time_s, poses)
