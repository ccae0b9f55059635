"""All methods on the same pictures: errors of hole, edge and corner, and the time each takes."""

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from cellctl.vision import Edge, ExpectedEdge, NotFound
from cellctl.vision.features import Matrix
from tests.benchmarks.vision.errors import (
    BASE_EDGE_MM,
    BATTERY_EDGES_MM,
    FARTHEST_CORNER_MM,
    FARTHEST_DEG,
    FARTHEST_MM,
    SKIP_MM,
    Errors,
    across_um,
    corner_bound_um,
    edge_bounds,
    hole_bound_um,
    line_errors,
    meeting,
)
from tests.benchmarks.vision.regions import Straight, circle_region, line_region
from tests.vision_regimes import Case, Regime, base_case, battery_case
from tests.vision_scenes import View, line_error

OURS = "ours"
HOLE, OFFSET, ANGLE = "hole um", "edge um", "edge mdeg"
CORNER, CORNER_ANGLE = "corner um", "corner's edges mdeg"
NEAR_MM = 0.6  # where the base's edge must be once the hole is known: the groove beside it is further away
QUANTITIES = (HOLE, OFFSET, ANGLE, CORNER, CORNER_ANGLE)


class Contest:
    """Errors by quantity and method, and milliseconds by feature and method."""

    def __init__(self, circles: dict[str, Any], lines: dict[str, Any]) -> None:
        self.circles, self.lines = circles, lines
        self.errors: dict[str, dict[str, Errors]] = {quantity: defaultdict(Errors) for quantity in QUANTITIES}
        self.ms: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        self.refusals: list[str] = []
        self.distances: list[float] = []  # Mahalanobis, per root of the degrees of freedom

    def run(self, regime: Regime, numbers: Iterable[int], seed: int) -> None:
        """Render a base and a battery for each number, and show both to everybody."""
        for number in numbers:
            rng = np.random.default_rng([seed, number])
            self._base(base_case(rng, regime))
            self._battery(battery_case(rng, regime))

    def plain(self) -> dict[str, Any]:
        """All of it as numbers, lists and dictionaries."""
        errors = {q: {name: asdict(each) for name, each in mine.items()} for q, mine in self.errors.items()}
        ms = {feature: dict(mine) for feature, mine in self.ms.items()}
        return {"errors": errors, "ms": ms, "refusals": self.refusals}

    def add(self, plain: dict[str, Any]) -> None:
        """Another contest's results."""
        self.refusals += plain["refusals"]
        for quantity, mine in plain["errors"].items():
            for name, errors in mine.items():
                self.errors[quantity][name].add(Errors(**errors))
        for feature, mine in plain["ms"].items():
            for name, ms in mine.items():
                self.ms[feature][name] += ms

    # -- a base ---------------------------------------------------------------------------------------

    def _base(self, case: Case) -> None:
        self.our_base(case)
        view, bound = case.view, hole_bound_um(case)
        hole = circle_region(view)
        for name, method in self.circles.items():
            found = self._timed("hole", name, lambda m=method: m(hole))
            at = None if found is None else (found[0] + hole.left, found[1] + hole.top)
            self._note_hole(case, name, at, bound)
        region = line_region(view, _known(view), 0.0, NEAR_MM)
        for name, method in self.lines.items():
            found = self._timed("edge", name, lambda m=method: m(region))
            self._note_edge(case, name, None if found is None else _moved(found, region.left, region.top))

    def our_base(self, case: Case) -> None:
        try:
            seen = self._timed("base", OURS, case.view.base)
        except NotFound as refusal:
            self.refusals.append(f"base: {refusal}")
            for quantity in (HOLE, OFFSET, ANGLE):
                self.errors[quantity][OURS].failures += 1
            return
        bound = hole_bound_um(case)
        um_per_px = 1000.0 / case.view.optics.px_per_mm
        self.distances.append(
            _mahalanobis(np.subtract(seen.circle.centre, case.view.truth[0]), seen.circle.covariance_px2)
        )
        offset_px, turn_deg = line_error(seen.edge, *case.view.truth[1:])
        self.distances.append(_mahalanobis(np.array([offset_px, turn_deg]), seen.edge.covariance))
        for axis in (0, 1):
            sigma = um_per_px * math.sqrt(seen.circle.covariance_px2[axis][axis])
            off = um_per_px * (seen.circle.centre[axis] - case.view.truth[0][axis])
            self.errors[HOLE][OURS].note(off, bound, sigma)
        offset, angle = line_errors(case, _straight(seen.edge), *case.view.truth[1:])
        bounds = edge_bounds(case, BASE_EDGE_MM, "edge")
        self.errors[OFFSET][OURS].note(offset, bounds[0], um_per_px * seen.edge.offset_sd_px)
        self.errors[ANGLE][OURS].note(angle, bounds[1], 1e3 * seen.edge.angle_sd_deg)

    def _note_hole(self, case: Case, name: str, at: tuple[float, float] | None, bound: float) -> None:
        errors, true = self.errors[HOLE][name], case.view.truth[0]
        if at is None or math.dist(at, true) > FARTHEST_MM * case.view.optics.px_per_mm:
            errors.failures += 1
            return
        for found, there in zip(at, true, strict=True):
            errors.note((found - there) * 1000.0 / case.view.optics.px_per_mm, bound)

    def _note_edge(self, case: Case, name: str, found: Straight | None) -> None:
        offset, angle = (math.inf, math.inf) if found is None else line_errors(case, found, *case.view.truth[1:])
        if abs(offset) > 1e3 * FARTHEST_MM or abs(angle) > 1e3 * FARTHEST_DEG:
            for quantity in (OFFSET, ANGLE):
                self.errors[quantity][name].failures += 1
            return
        bounds = edge_bounds(case, BASE_EDGE_MM, "edge")
        self.errors[OFFSET][name].note(offset, bounds[0])
        self.errors[ANGLE][name].note(angle, bounds[1])

    # -- a battery ------------------------------------------------------------------------------------

    def _battery(self, case: Case) -> None:
        self.our_battery(case)
        view = case.view
        regions = [line_region(view, edge, SKIP_MM * view.optics.px_per_mm) for edge in view.features]
        for name, method in self.lines.items():
            found = [self._timed("corner", name, lambda m=method, r=r: m(r)) for r in regions]
            lines = [None if f is None else _moved(f, r.left, r.top) for f, r in zip(found, regions, strict=True)]
            self._note_corner(case, name, lines)

    def our_battery(self, case: Case) -> None:
        try:
            seen = self._timed("battery", OURS, case.view.battery)
        except NotFound as refusal:
            self.refusals.append(f"battery: {refusal}")
            for quantity in (CORNER, CORNER_ANGLE):
                self.errors[quantity][OURS].failures += 1
            return
        um_per_px, corner = 1000.0 / case.view.optics.px_per_mm, case.view.truth[0]
        edges = (seen.edge_1, seen.edge_2)
        turns = [line_error(edge, corner, end)[1] for edge, end in zip(edges, case.view.truth[1:], strict=True)]
        self.distances.append(_mahalanobis(np.array([*np.subtract(seen.corner, corner), *turns]), seen.covariance))
        for edge, end, length in zip(edges, case.view.truth[1:], BATTERY_EDGES_MM, strict=True):
            normal = np.array([-(end.v - corner.v), end.u - corner.u]) / math.dist(corner, end)
            sigma = um_per_px * math.sqrt(float(normal @ np.array(seen.corner_covariance_px2) @ normal))
            off = across_um(case, seen.corner, corner, end)
            self.errors[CORNER][OURS].note(off, corner_bound_um(case, length), sigma)
            _, angle = line_errors(case, _straight(edge), corner, end)
            bound = edge_bounds(case, length, "battery")[1]
            self.errors[CORNER_ANGLE][OURS].note(angle, bound, 1e3 * edge.angle_sd_deg)

    def _note_corner(self, case: Case, name: str, lines: list[Straight | None]) -> None:
        corner, ends = case.view.truth[0], case.view.truth[1:]
        one, two = lines
        angles = [
            math.inf if line is None else line_errors(case, line, corner, end)[1]
            for line, end in zip(lines, ends, strict=True)
        ]
        if one is None or two is None or max(map(abs, angles)) > 1e3 * FARTHEST_DEG:
            self._fail_corner(name)
            return
        found = meeting(one, two)
        if math.dist(found, corner) > FARTHEST_CORNER_MM * case.view.optics.px_per_mm:
            self._fail_corner(name)
            return
        for angle, end, length in zip(angles, ends, BATTERY_EDGES_MM, strict=True):
            off = across_um(case, found, corner, end)
            self.errors[CORNER][name].note(off, corner_bound_um(case, length))
            self.errors[CORNER_ANGLE][name].note(angle, edge_bounds(case, length, "battery")[1])

    def _fail_corner(self, name: str) -> None:
        for quantity in (CORNER, CORNER_ANGLE):
            self.errors[quantity][name].failures += 1

    def _timed(self, feature: str, name: str, work: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        try:
            return work()
        finally:
            self.ms[feature][name].append(1e3 * (time.perf_counter() - start))


def _known(view: View) -> ExpectedEdge:
    """The base's edge at its true place: nobody has to search for it."""
    start, end = view.truth[1:]
    return ExpectedEdge(start, end, view.features[1].bright_left)


def _moved(line: Straight, left: int, top: int) -> Straight:
    return Straight((line.point[0] + left, line.point[1] + top), line.way)


def _mahalanobis(error: np.ndarray, covariance: Matrix) -> float:
    """Distance in own sigmas, so that its mean square is 1."""
    return math.sqrt(float(error @ np.linalg.solve(np.array(covariance), error)) / len(error))


def _straight(edge: Edge) -> Straight:
    return Straight(tuple(edge.middle), (edge.end.u - edge.start.u, edge.end.v - edge.start.v))
