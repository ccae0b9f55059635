"""The camera over one plane through an ordinary lens: perspective and full distortion, and what no lens can be."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.calibration.distortion import distort, jacobians, undistort, usable_radius
from cellctl.calibration.plane_map import PlaneMap

FOCAL, CENTRE = 2400.0, (1290.0, 980.0)
K = (-0.12, 0.05, 0.3, 0.0008, -0.0005)  # k1, k2, k3, p1, p2 in units of the focal length
HEIGHT_MM = 120.0


def over_a_plane(tilt_deg: float) -> tuple[PlaneMap, np.ndarray, np.ndarray]:
    """A pinhole camera 120 mm over a plane as a map, and OpenCV's rotation vector and place of the same camera."""
    turn = cv2.Rodrigues(np.radians([180.0 - tilt_deg, 0.0, 0.0]))[0]
    place = -turn @ np.array([30.0, -20.0, 0.0]) + (0, 0, HEIGHT_MM)
    whole = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]]) @ np.column_stack([turn[:, :2], place])
    whole /= whole[2, 2]
    camera = PlaneMap(
        matrix_px_per_mm=tuple(tuple(row) for row in whole[:2, :2].tolist()),
        offset_px=tuple(whole[:2, 2].tolist()),
        k1_per_px2=K[0] / FOCAL**2,
        distortion_centre_px=CENTRE,
        perspective_per_mm=tuple(whole[2, :2].tolist()),
        k2_per_px4=K[1] / FOCAL**4,
        k3_per_px6=K[2] / FOCAL**6,
        p1_per_px=K[3] / FOCAL,
        p2_per_px=K[4] / FOCAL,
    )
    return camera, cv2.Rodrigues(turn)[0].ravel(), place


GRID_MM = np.stack(np.meshgrid(np.linspace(-30, 90, 13), np.linspace(-60, 20, 9)), -1).reshape(-1, 2)


@pytest.mark.parametrize("tilt_deg", [0.0, 3.0, 12.0])
def test_the_map_of_a_pinhole_camera_over_a_plane_is_opencvs(tilt_deg):
    camera, turn, place = over_a_plane(tilt_deg)
    matrix = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1.0]])
    order = np.array([K[0], K[1], K[3], K[4], K[2]])
    points = np.column_stack([GRID_MM, np.zeros(len(GRID_MM))])
    expected = cv2.projectPoints(points, turn, place, matrix, order)[0].reshape(-1, 2)
    assert np.abs(camera.px_from_mm(GRID_MM) - expected).max() < 1e-7
    assert np.abs(camera.mm_from_px(expected) - GRID_MM).max() < 1e-8
    assert camera.mirrored()
    assert camera.mm_per_px == pytest.approx(HEIGHT_MM / FOCAL, rel=0.1)
    assert PlaneMap.from_dict(json.loads(json.dumps(camera.as_dict()))) == camera


def test_the_jacobian_is_the_slope_of_the_map():
    camera, _, _ = over_a_plane(8.0)
    step = 1e-5
    for axis in (0, 1):
        way = np.eye(2)[axis] * step
        slope = (camera.px_from_mm(GRID_MM + way) - camera.px_from_mm(GRID_MM - way)) / (2 * step)
        assert np.abs(camera.jacobian(GRID_MM)[:, :, axis] - slope).max() < 1e-5


def test_a_dot_seen_askew_appears_beside_its_centre():
    camera, _, _ = over_a_plane(20.0)
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    seen = camera.dot_centres_px(GRID_MM[:5], [4.0] * 5)
    for middle, point in zip(seen, GRID_MM[:5], strict=True):
        rim = camera.px_from_mm(point + 2.0 * np.column_stack([np.cos(angle), np.sin(angle)])) - middle
        moments = cv2.moments(rim.astype(np.float32))
        assert np.hypot(moments["m10"], moments["m01"]) / moments["m00"] < 0.003
    assert np.abs(seen - camera.px_from_mm(GRID_MM[:5])).max() > 0.05


def test_a_point_behind_the_horizon_is_refused():
    camera, _, _ = over_a_plane(12.0)
    with pytest.raises(ValueError, match="horizon"):
        camera.px_from_mm([(0.0, -1e6)] if camera.perspective_per_mm[1] > 0 else [(0.0, 1e6)])


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"perspective_per_mm": (math.inf, 0.0)}, "finite"),
        ({"k2_per_px4": 1e-10}, "k2"),
        ({"k3_per_px6": -1e-17}, "k3"),
        ({"p1_per_px": 0.01}, "p1"),
        ({"perspective_per_mm": (0.03, 0.03)}, "scale|differ"),
    ],
)
def test_a_lens_that_does_not_exist_is_refused(changed, says):
    with pytest.raises(ValueError, match=says):
        replace(over_a_plane(3.0)[0], **changed)


coefficients = st.tuples(*(st.floats(-limit, limit) for limit in (0.3, 0.2, 0.2, 0.005, 0.005))).map(np.array)


@given(coefficients, st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_distortion_is_opencvs_and_is_undone_wherever_it_may_be_used(lens, seed):
    radius = min(0.6, 0.8 * usable_radius(lens))
    points = np.random.default_rng(seed).uniform(-1, 1, (20, 2)) * radius / math.sqrt(2)
    bent = distort(points, lens)
    k1, k2, k3, p1, p2 = lens.tolist()
    space = np.column_stack([points, np.ones(20)])
    theirs = cv2.projectPoints(space, np.zeros(3), np.zeros(3), np.eye(3), np.array([k1, k2, p1, p2, k3]))[0]
    assert np.abs(bent - theirs.reshape(-1, 2)).max() < 1e-12
    assert np.abs(undistort(bent, lens, "focal lengths") - points).max() < 1e-9


@given(coefficients)
@settings(max_examples=40, deadline=None)
def test_the_derivatives_of_distortion_are_its_slopes(lens):
    points = np.random.default_rng(1).uniform(-0.6, 0.6, (9, 2))
    by_point, by_coefficient = jacobians(points, lens)
    for axis in (0, 1):
        way = np.eye(2)[axis] * 1e-6
        assert (
            np.abs((distort(points + way, lens) - distort(points - way, lens)) / 2e-6 - by_point[..., axis]).max()
            < 1e-8
        )
    for index in range(5):
        way = np.eye(5)[index] * 1e-6
        slope = (distort(points, lens + way) - distort(points, lens - way)) / 2e-6
        assert np.abs(slope - by_coefficient[..., index]).max() < 1e-9


def test_a_point_that_no_lens_sees_is_refused():
    with pytest.raises(ValueError, match="focal lengths from the distortion centre"):
        undistort(np.array([[5.0, 0.0]]), np.array([-0.3, 0, 0, 0, 0.0]), "focal lengths")
