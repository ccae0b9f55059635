"""The largest step in short grey profiles, by differences of boxes: finds an outline, does not measure it. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.features import Floats, Singles
from cellctl.vision.robust import Bools, middle

Which: TypeAlias = Bools | NDArray[np.intp] | slice

APART_PX = 6.0  # steps nearer than this are one
HAAR_PX = 4  # half width of the narrow step detector
NEAR_PX, PLATEAU_PX = 11, 15  # the wide one compares the levels so far to either side: no scratch is a step to it


def step_response(profiles: Singles, rising: float) -> tuple[Floats, Singles]:
    """Place and height of the largest step in each profile (n, m), by the difference of two boxes."""
    total = np.cumsum(profiles, axis=1)
    total = np.concatenate([np.zeros((len(total), 1), total.dtype), total], axis=1)
    centre = total[:, HAAR_PX : total.shape[1] - HAAR_PX]
    response = total[:, 2 * HAAR_PX :] + total[:, : total.shape[1] - 2 * HAAR_PX] - 2.0 * centre
    response *= np.float32(rising / HAAR_PX)
    place, best = _peaks(response)
    return place + (HAAR_PX - 0.5), response.take(best)


def _peaks(response: Singles) -> tuple[Floats, NDArray[np.intp]]:
    """Where each row (n, places) has its maximum, by a parabola; and which element of the whole that is."""
    count, places = response.shape
    best = response.argmax(axis=1)
    rows = np.arange(count) * places
    inner = np.minimum(np.maximum(best, 1), places - 2) + rows
    before, at, after = (response.take(inner + k) for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    part = 0.5 * (before - after) / np.where(np.abs(bend) > 1e-6, bend, 1.0)
    return best + np.minimum(np.maximum(part, -1.0), 1.0), best + rows


class Steps(NamedTuple):
    """The largest step of each profile (n,): its place in rows, its height by a narrow and by a wide detector."""

    place: Floats
    height: Singles
    wide: Singles

    def only(self, which: Which) -> Steps:
        """Some of them."""
        return Steps(self.place[which], self.height[which], self.wide[which])

    def width(self) -> float:
        """Roughly the sigma of the blur: it takes its share from the narrow detector, nothing from the wide one."""
        lost = math.sqrt(2.0 / math.pi) / HAAR_PX  # per sigma
        return min(max((1.0 - middle(self.height / self.wide)) / lost, 0.6), 3.0)


class Response(NamedTuple):
    """Step detectors over profiles (n, places): the lesser of the two, and the wide one."""

    least: Singles
    wide: Singles

    def without(self, place: Floats) -> Response:
        """The same, blind where a step has been found."""
        near = np.abs(np.arange(self.least.shape[1]) + (PLATEAU_PX - 0.5) - place[:, None]) < APART_PX
        return Response(np.where(near, np.float32(0.0), self.least), self.wide)


def respond(profiles: Singles) -> Response:
    """How steps show in profiles (n, rows); thin lines are no steps.

    Both detectors are differences of means over four pixels. No matrix product: BLAS would spread it over the cores.
    """
    pairs = profiles[:, 1:] + profiles[:, :-1]
    means = pairs[:, 2:] + pairs[:, :-2]
    means *= np.float32(1.0 / HAAR_PX)
    count = profiles.shape[1] + 1 - 2 * PLATEAU_PX
    ahead, behind = (means[:, begin : begin + count] for begin in (PLATEAU_PX, PLATEAU_PX - HAAR_PX))
    far = means[:, PLATEAU_PX + NEAR_PX :] - means[:, :count]
    return Response(np.minimum(ahead - behind, far), far)


def true_steps(seen: Response) -> Steps:
    """The largest step of each profile."""
    response, far = seen
    place, best = _peaks(response)
    return Steps(place + (PLATEAU_PX - 0.5), response.take(best), far.take(best))
