import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.geometry import Px
from cellctl.vision import (
    Appearance,
    BatteryMeasurement,
    Edge,
    ExpectedEdge,
    NotFound,
    Search,
    base_covariance,
    battery_covariance,
    find_circle,
    find_edge,
)
from cellctl.vision.covariance import as_matrix, corner_covariance
from cellctl.vision.scan import Line, Scan, edge_covariance
from simulators.place import Place
from tests.vision_scenes import Camera, base_view, battery_view, line_error

LOOK = Appearance(1.1, 90.0, 2.5, 40.0, 130.0, 0.0)
CORNER = Px(700.0, 500.0)


def edge_towards(turn_deg: float, sd_px: float, sd_deg: float, share: float) -> Edge:
    """From 200 to 1,400 px off the corner; `share` is the correlation of offset and angle."""
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    start, end = (Px(CORNER.u + c * r, CORNER.v + s * r) for r in (200.0, 1400.0))
    both = share * sd_px * sd_deg
    return Edge(start, end, ((sd_px**2, both), (both, sd_deg**2)), LOOK, 1.0, 0.02)


def moved(edge: Edge, offset_px: float, turn_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """A point and the direction of the edge's line after an error of offset (to the right hand) and angle (u to v)."""
    way = np.subtract(edge.end, edge.start) / math.dist(edge.start, edge.end)
    right = np.array([-way[1], way[0]])
    turn = math.radians(turn_deg)
    return np.array(edge.middle) + offset_px * right, way * math.cos(turn) + right * math.sin(turn)


@given(st.floats(-180, 180), st.floats(40, 140), st.floats(-0.9, 0.9))
def test_a_corners_covariance_is_that_of_corners_made_of_disturbed_edges(
    turn: float, apart: float, share: float
) -> None:
    edges = edge_towards(turn, 0.02, 0.003, share), edge_towards(turn + apart, 0.05, 0.001, -share)
    drawn = np.zeros((4, 4))
    for mode in range(4):  # a small error in each independent direction, by finite differences
        root = np.zeros((4, 4))
        for i, edge in enumerate(edges):
            root[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = np.linalg.cholesky(np.array(edge.covariance))
        step = 0.01 * root[:, mode]
        lines = [moved(edge, *step[2 * i : 2 * i + 2]) for i, edge in enumerate(edges)]
        (p, d), (q, e) = lines
        met = p + d * np.linalg.solve(np.stack([d, -e], axis=1), q - p)[0]
        change = np.array([*(met - CORNER), step[1], step[3]]) / 0.01
        drawn += np.outer(change, change)

    assert np.array(corner_covariance(CORNER, *edges)) == pytest.approx(drawn, rel=1e-3, abs=1e-9)


def test_a_batterys_pose_has_the_corner_and_one_edges_angle_with_their_cross_terms() -> None:
    one, two = edge_towards(0.0, 0.02, 0.003, 0.2), edge_towards(90.0, 0.05, 0.001, 0.0)
    seen = BatteryMeasurement(one, two, CORNER, corner_covariance(CORNER, one, two), 0.0)
    by_one, by_two = (battery_covariance(seen, edge) for edge in (one, two))

    assert by_one[:2, :2] == pytest.approx(np.array(seen.corner_covariance_px2))
    assert math.sqrt(by_one[2, 2]) == pytest.approx(0.003)
    assert math.sqrt(by_two[2, 2]) == pytest.approx(0.001)
    assert abs(by_one[1, 2]) > 0.8 * math.sqrt(by_one[1, 1] * by_one[2, 2])  # v of the corner hangs on edge 1's angle
    assert abs(by_one[0, 2]) < 1e-9
    with pytest.raises(ValueError, match="measured edges"):
        battery_covariance(seen, edge_towards(10.0, 0.1, 0.1, 0.0))


def test_a_bases_pose_has_the_holes_and_the_edges_covariance() -> None:
    seen = base_view(np.random.default_rng(1)).base()
    pose = base_covariance(seen)

    assert pose[:2, :2] == pytest.approx(np.array(seen.circle.covariance_px2))
    assert math.sqrt(pose[2, 2]) == pytest.approx(seen.edge.angle_sd_deg)
    assert np.linalg.eigvalsh(pose).min() > 0.0


@pytest.mark.parametrize("start_deg", [0, 60, 100, 170, 190, 260, 280, 350])
@pytest.mark.parametrize("bright_left", [True, False])
def test_an_edges_offset_counts_to_the_right_hand_and_its_angle_from_u_to_v(
    start_deg: float, bright_left: bool
) -> None:
    expected = edge_towards(float(start_deg), 0.0, 0.0, 0.0)
    scan = Scan.of(ExpectedEdge(expected.start, expected.end, bright_left))
    along = [scan.along(p) for p in (expected.start, expected.end)]
    slope = (scan.across(expected.end) - scan.across(expected.start)) / (along[1] - along[0])
    line = Line(along[0], scan.across(expected.start), slope)
    tiny = 1e-5
    way, found = np.subtract(expected.end, expected.start), []
    for height, turn in ((tiny, 0.0), (0.0, tiny)):
        ends = [np.array(scan.point(a, line.across(np.array(a)) + height + turn * (a - line.at))) for a in along]
        middle = (ends[0] + ends[1]) / 2 - np.array(expected.middle)
        right = np.array([-way[1], way[0]]) / np.hypot(*way)
        turned = np.cross(np.append(way, 0), np.append(ends[1] - ends[0], 0))[2] / float(way @ way)
        found.append((float(middle @ right), math.degrees(turned)))
    jacobian = np.array(found).T / tiny
    spread = np.array([[4e-4, 1e-7], [1e-7, 1e-9]])

    covariance = edge_covariance(scan, line, expected.start, expected.end, spread)
    assert np.array(covariance) == pytest.approx(jacobian @ spread @ jacobian.T, rel=1e-4)


def test_single_features_are_found_as_in_the_whole_part() -> None:
    view = base_view(np.random.default_rng(2), Camera(turn_deg=2.0), Place(0.3, -0.2, 0.5))
    whole = view.base()
    hole = find_circle(view.pixels, view.features[0], view.search, view.limits)
    edge = find_edge(view.pixels, view.features[1], Search(90.0, 2.0), view.limits)

    assert hole == whole.circle
    offset, turn = line_error(edge, whole.edge.start, whole.edge.end)
    assert abs(offset) < 0.02
    assert abs(turn) < 0.002
    with pytest.raises(NotFound, match="view"):
        find_edge(view.pixels[:, 1200:], view.features[1], Search(90.0, 2.0), view.limits)


def test_what_focus_and_light_are_judged_by_is_what_the_picture_has() -> None:
    for exposure in (0.7, 1.2):
        view = base_view(np.random.default_rng(3), Camera(exposure=exposure, noise=3.0, blur_px=1.4), texture=0.0)
        held = battery_view(np.random.default_rng(3), Camera(exposure=exposure, noise=3.0, blur_px=1.4), texture=0.0)
        hole, edge = view.base().appearances.values()

        for look in (hole, edge, *held.battery().appearances.values()):
            assert look.blur_px == pytest.approx(1.4, abs=0.05)
            assert look.noise == pytest.approx(3.0, rel=0.15)
            assert look.saturated == 0.0
        assert hole.contrast == pytest.approx(exposure * 100.0, rel=0.04)
        assert edge.contrast == pytest.approx(exposure * 85.0, rel=0.06)
        assert edge.dark == pytest.approx(6.0 + exposure * 45.0, abs=3.0)
        assert edge.bright == pytest.approx(6.0 + exposure * 130.0, rel=0.05)


def test_a_covariance_becomes_symmetric_numbers() -> None:
    assert as_matrix(np.array([[1.0, 0.5], [0.7, 2.0]])) == ((1.0, 0.6), (0.6, 2.0))
