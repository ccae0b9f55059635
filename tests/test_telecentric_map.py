"""The telecentric camera over one plane: px to mm and back, exactly, and what no camera can be."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.view import drawn_setup
from cellctl.geometry import Pose, Px
from tests.calibration_cells import CENTRE, PICTURE, PX_PER_MM, drawn

finite = {"allow_nan": False, "allow_infinity": False}
maps = st.builds(
    lambda scale, turn, mirrored, squeeze, shear, axis, k1, centre: PlaneMap.from_arrays(
        matrix := scale
        * np.diag([1.0, -1.0 if mirrored else 1.0])
        @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        @ np.array([[1.0, shear], [0.0, squeeze]]),
        CENTRE - matrix @ np.array(axis),
        k1,
        CENTRE + np.array(centre),
    ),
    st.floats(20, 400),
    st.floats(-math.pi, math.pi),
    st.booleans(),
    st.floats(0.95, 1.0),
    st.floats(-0.05, 0.05),
    st.tuples(st.floats(-400, 400), st.floats(-400, 400)),
    st.floats(-2e-9, 2e-9),
    st.tuples(st.floats(-300, 300), st.floats(-300, 300)),
)


@given(maps, st.lists(st.tuples(st.floats(-500, 3100), st.floats(-500, 2500)), min_size=1, max_size=20))
@settings(max_examples=80, deadline=None)
def test_px_to_mm_and_mm_to_px_undo_each_other(camera, points):
    points_px = np.array(points)
    mm = camera.mm_from_px(points_px)
    assert np.abs(camera.px_from_mm(mm) - points_px).max() < 1e-9
    assert np.abs(camera.mm_from_px(camera.px_from_mm(mm)) - mm).max() < 1e-9


@given(maps)
@settings(max_examples=50, deadline=None)
def test_a_map_survives_its_file_to_the_last_digit(camera):
    assert PlaneMap.from_dict(json.loads(json.dumps(camera.as_dict()))) == camera


def test_a_camera_that_looks_down_sees_x_to_the_right_and_y_upwards():
    camera = drawn("eye_in_hand").plane_map
    middle, right, up = camera.px_from_mm([(55, 0), (56, 0), (55, 1)])
    assert np.allclose(right - middle, (PX_PER_MM, 0))
    assert np.allclose(up - middle, (0, -PX_PER_MM))
    assert camera.mirrored()


def test_a_camera_that_looks_up_sees_x_to_the_right_and_y_downwards():
    camera = drawn("eye_to_hand").plane_map
    middle, right, down = camera.px_from_mm([(300, -120), (301, -120), (300, -119)])
    assert np.allclose(right - middle, (PX_PER_MM, 0))
    assert np.allclose(down - middle, (0, PX_PER_MM))
    assert not camera.mirrored()


@pytest.mark.parametrize("mirrored", [True, False])
def test_the_rotation_is_where_the_u_axis_points(mirrored):
    setup = drawn_setup(
        "eye_in_hand", camera=Pose(3, 4, 20), mirrored=mirrored, px_per_mm=100, board=Pose(0, 0, 0), picture_px=PICTURE
    )
    start, end = setup.plane_map.mm_from_px([(1000, 900), (1100, 900)])
    assert math.degrees(math.atan2(*(end - start)[::-1])) == pytest.approx(20)
    assert setup.plane_map.rotation_deg == pytest.approx(20)
    assert setup.plane_map.mm_at(Px(*CENTRE)) == pytest.approx((3, 4))
    assert setup.plane_map.mm_per_px == pytest.approx(0.01)


def test_a_tilt_shows_as_squeeze():
    camera = PlaneMap(((100.0, 0.0), (0.0, 100.0 * math.cos(math.radians(2)))), (0.0, 0.0), 0.0, (0.0, 0.0))
    assert camera.tilt_deg == pytest.approx(2)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"matrix_px_per_mm": ((0.0, 0.0), (0.0, 0.0))}, "scale"),
        ({"matrix_px_per_mm": ((100.0, 100.0), (100.0, 100.0))}, "scale"),
        ({"matrix_px_per_mm": ((100.0, 0.0), (0.0, 60.0))}, "differ"),
        ({"offset_px": (math.nan, 0.0)}, "finite"),
        ({"k1_per_px2": 1e-6}, "k1"),
    ],
)
def test_a_map_that_no_camera_has_is_refused(changed, says):
    good = drawn("eye_in_hand").plane_map
    with pytest.raises(ValueError, match=says):
        replace(good, **changed)


def test_a_point_far_outside_a_barrel_lens_is_refused():
    camera = replace(drawn("eye_to_hand").plane_map, k1_per_px2=-4e-9)
    with pytest.raises(ValueError, match="px from the distortion centre"):
        camera.px_from_mm([(400, 100)])
    with pytest.raises(ValueError, match="px from the distortion centre"):
        camera.mm_from_px([(30000, 0)])


@pytest.mark.parametrize("points", [[1.0, 2.0], [[1.0, 2.0, 3.0]], [[math.inf, 0.0]]])
def test_points_of_the_wrong_shape_are_refused(points):
    with pytest.raises(ValueError, match="points must be"):
        drawn("eye_to_hand").plane_map.px_from_mm(points)


json_like = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-5, 5) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=6,
)
KEYS = ["matrix_px_per_mm", "offset_px", "k1_per_px2", "distortion_centre_px"]


@given(st.dictionaries(st.sampled_from([*KEYS, "extra"]), json_like))
@example({**drawn("eye_in_hand").plane_map.as_dict(), "k1_per_px2": True})
@example({**drawn("eye_in_hand").plane_map.as_dict(), "extra": 0.0})
@settings(max_examples=60, deadline=None)
def test_a_wrong_table_is_refused_with_a_sentence(table: dict[str, Any]):
    with pytest.raises(ValueError, match="plane map:"):
        PlaneMap.from_dict(table)
