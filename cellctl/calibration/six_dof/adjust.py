"""Camera and target at once, so that every sighting is met as well as its noise allows; with covariance.

The unknowns are small motions of X and of Z in their own inner frames (place mm, turn rad), and with a stream the
time by which the robot's clock is late. Residuals are in the camera's frame: place (3) mm, turn (3) rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellctl.calibration.adjustment import Normal, minimise
from cellctl.calibration.six_dof.closed_form import Solution
from cellctl.calibration.six_dof.pairs import Pairs
from cellctl.calibration.six_dof.rigid import (
    FloatArray,
    cross_matrix,
    inverse,
    left_jacobian_inverse,
    right_jacobian,
    rigid,
    rotation_from_vector,
    vector_from_rotation,
)

MOTIONS = 12  # unknowns of X and Z; the time is one more
KNOWN_SD_MM = 1e-3


class Sigmas(NamedTuple):
    """One-sigma noise of a sighting, robot and camera together, in the camera's frame."""

    lateral_mm: float
    depth_mm: float
    tilt_deg: float  # about an axis across the view
    roll_deg: float  # about the line of sight

    @property
    def of_residuals(self) -> FloatArray:
        """Of the six residuals: mm, rad."""
        tilt, roll = math.radians(self.tilt_deg), math.radians(self.roll_deg)
        return np.array([self.lateral_mm, self.lateral_mm, self.depth_mm, tilt, tilt, roll])


class Known(NamedTuple):
    """What the motion cannot tell and a person has measured: the camera's place along a direction of its carrier."""

    direction: FloatArray  # (3,), of length 1
    place_mm: float


@dataclass(frozen=True, eq=False)
class Sightings:
    """One adjustment near a solution; a least-squares problem for `minimise`."""

    pairs: Pairs
    near: Solution
    sigmas: Sigmas
    known: Known | None = None

    @property
    def start(self) -> FloatArray:
        """The unknowns at `near`."""
        return np.zeros(MOTIONS + (self.pairs.swing is not None))

    def solution(self, x: FloatArray) -> Solution:
        """X and Z at these unknowns."""
        return Solution(_moved(self.near.camera, x[:6]), _moved(self.near.target, x[6:12]))

    def seen(self, x: FloatArray) -> FloatArray:
        """camera_from_target (n, 4, 4) as it should be seen."""
        camera, target = self.solution(x)
        arm = self.pairs.arm
        if self.pairs.swing is not None:
            late = self.pairs.swing * x[MOTIONS]
            arm = rigid(rotation_from_vector(late[:, 3:]), late[:, :3]) @ arm
        return np.asarray(inverse(camera) @ arm @ target, np.float64)

    def residuals(self, x: FloatArray) -> FloatArray:
        """Expected minus seen, (n, 6): mm, rad."""
        expected, seen = self.seen(x), self.pairs.target
        turned = expected[:, :3, :3] @ seen[:, :3, :3].transpose(0, 2, 1)
        return np.concatenate([expected[:, :3, 3] - seen[:, :3, 3], vector_from_rotation(turned)], axis=1)

    def cost(self, x: FloatArray) -> float:
        """Sum of squares in sigmas."""
        return float(((self.residuals(x) / self.sigmas.of_residuals) ** 2).sum() + (self._known(x) ** 2).sum())

    def normal(self, x: FloatArray) -> Normal:
        """The normal equations; nothing belongs to a single pose."""
        sigmas, count = self.sigmas.of_residuals, len(self.pairs)
        rows = (self.jacobian(x) / sigmas[:, None]).reshape(6 * count, -1)
        off = (self.residuals(x) / sigmas).reshape(-1)
        known = self._known_rows(x)
        return Normal(
            cost=self.cost(x),
            ss=rows.T @ rows + known.T @ known,
            sp=np.zeros((0, rows.shape[1], 0)),
            pp=np.zeros((0, 0, 0)),
            s=rows.T @ off + known.T @ self._known(x),
            p=np.zeros((0, 0)),
        )

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Derivatives of the residuals by the unknowns, (n, 6, 12 or 13)."""
        expected = self.seen(x)
        place, turn = expected[:, :3, 3], expected[:, :3, :3]
        by_turn = left_jacobian_inverse(self.residuals(x)[:, 3:])
        rows = np.zeros((len(self.pairs), 6, len(x)))
        rows[:, :3, 0:3], rows[:, :3, 3:6] = -np.eye(3), cross_matrix(place)
        rows[:, 3:, 3:6] = -by_turn
        rows[:, :3, 6:9], rows[:, 3:, 9:12] = turn, by_turn @ turn
        for columns in (slice(0, 6), slice(6, 12)):
            rows[:, :, columns] = rows[:, :, columns] @ _inner(x[columns])
        if self.pairs.swing is not None:
            rows[:, :, MOTIONS] = self._by_time(x, place, by_turn)
        return rows

    def _by_time(self, x: FloatArray, place: FloatArray, by_turn: FloatArray) -> FloatArray:
        """How the sightings change while the arm swings on, (n, 6) per second."""
        assert self.pairs.swing is not None
        camera = self.solution(x).camera
        turn, carried = camera[:3, :3], place @ camera[:3, :3].T + camera[:3, 3]
        speed, spin = self.pairs.swing[:, :3], self.pairs.swing[:, 3:]
        moved = (speed + np.cross(spin, carried - speed * x[MOTIONS])) @ turn
        return np.concatenate([moved, np.einsum("nij,nj->ni", by_turn, spin @ turn)], axis=1)

    def _known(self, x: FloatArray) -> FloatArray:
        if self.known is None:
            return np.zeros(0)
        place = self.solution(x).camera[:3, 3]
        return np.array([(self.known.direction @ place - self.known.place_mm) / KNOWN_SD_MM])

    def _known_rows(self, x: FloatArray) -> FloatArray:
        rows = np.zeros((self._known(x).size, len(x)))
        if self.known is not None:
            rows[0, :3] = self.known.direction @ self.near.camera[:3, :3] / KNOWN_SD_MM
        return rows


def refined(pairs: Pairs, near: Solution, sigmas: Sigmas, known: Known | None = None) -> tuple[Sightings, FloatArray]:
    """The adjustment, linearised at its minimum, and the unknowns there: only the time is not 0."""
    first = Sightings(pairs, near, sigmas, known)
    x = minimise(first, first.start)
    there = x.copy()
    there[:MOTIONS] = 0.0
    return Sightings(pairs, first.solution(x), sigmas, known), there


def _moved(motion: FloatArray, by: FloatArray) -> FloatArray:
    """A motion moved in its inner frame by a place (3) and a rotation vector (3)."""
    return np.asarray(motion @ rigid(rotation_from_vector(by[3:]), by[:3]), np.float64)


def _inner(by: FloatArray) -> FloatArray:
    """How the moved motion moves in its own frame per change of `by`, (6, 6)."""
    both = np.zeros((6, 6))
    both[:3, :3] = rotation_from_vector(-by[3:])
    both[3:, 3:] = right_jacobian(by[3:])
    return both
