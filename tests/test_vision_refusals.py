import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cellctl.geometry import Px
from cellctl.vision import (
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    NotFound,
    Search,
    find_base,
    find_battery,
    find_edge,
)
from simulators.parts import FOIL, BaseDrawing
from simulators.place import Place
from simulators.render import Polygon, Scene, render
from tests.vision_scenes import (
    BASE_SEARCH,
    BATTERY_SEARCH,
    EDGE_MM,
    Camera,
    View,
    base_view,
    battery_view,
    some_place,
)

JUNK = hnp.arrays(
    dtype=st.sampled_from([np.uint8, np.uint16, np.float32, np.bool_]),
    shape=hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=9),
)
pytestmark = pytest.mark.usefixtures("one_thread")


def refusal(view: View, find: str = "base") -> str:
    with pytest.raises(NotFound) as caught:
        view.base() if find == "base" else view.battery()
    assert caught.value.detail in str(caught.value)
    return caught.value.check


# -- refusals -----------------------------------------------------------------------------------------------


def test_texture_alone_is_refused() -> None:
    square = np.array([[-20.0, -20.0], [20.0, -20.0], [20.0, 20.0], [-20.0, 20.0]])
    base, battery = (v(np.random.default_rng(11)) for v in (base_view, battery_view))
    pixels = render(Scene(120.0, [Polygon(square, 120.0, texture=2.5)]), base.optics, np.random.default_rng(12))

    assert refusal(base._replace(pixels=pixels)) in {"hole", "contrast"}
    assert refusal(battery._replace(pixels=pixels), "battery") in {"edge 1", "contrast"}


def test_a_base_is_no_battery_and_a_battery_is_no_base() -> None:
    rng = np.random.default_rng(13)
    for corner in ((-1, -1), (1, 1)):
        for _ in range(3):
            base, battery = (
                base_view(rng, Camera(), some_place(rng)),
                battery_view(rng, Camera(), some_place(rng), corner),
            )

            assert refusal(battery._replace(pixels=base.pixels), "battery")
            assert refusal(base._replace(pixels=battery.pixels)).startswith("hole")


def test_an_edge_that_goes_on_past_the_corner_is_refused() -> None:
    view = battery_view(np.random.default_rng(14))
    corner, (edge_1, edge_2) = view.truth[0], view.features
    pixels = view.pixels.copy()
    row = round(corner.v)
    pixels[row : row + 300, : round(corner.u) + 200] = 150

    assert refusal(view._replace(pixels=pixels, features=(edge_1, edge_2)), "battery") == "corner"


@pytest.mark.parametrize("beyond_mm", [0.08, 0.12, 0.15, 0.17, 0.20, 0.30])
def test_a_battery_with_something_like_it_over_half_of_an_edge_is_refused(beyond_mm: float) -> None:
    """As much is seen of the true edge as of that thing's, which runs beside it: which one is meant?"""
    x_mm, y_mm = -26.5, -42.5
    inner, outer = y_mm + 0.1, y_mm - beyond_mm
    left, right = x_mm + 4.0, x_mm + 8.5
    lid = Polygon(np.array([[left, inner], [right, inner], [right, outer], [left, outer]]), FOIL)
    assert refusal(battery_view(np.random.default_rng(30), over=[lid]), "battery") in {
        "edge 1 rival",
        "edge 1 residual",
    }


def strip_along(edge: int, left_mm: float, wide_mm: float = 0.4, level: float = 50.0) -> Polygon:
    """A strip on the battery along one of its edges, which leaves so much of the battery free outside it."""
    x_mm, y_mm = -26.5, -42.5
    near, far = left_mm, left_mm + wide_mm
    if edge == 1:
        corners = [[x_mm - 2.0, y_mm + near], [13.0, y_mm + near], [13.0, y_mm + far], [x_mm - 2.0, y_mm + far]]
    else:
        corners = [[x_mm + near, y_mm - 2.0], [x_mm + near, -30.0], [x_mm + far, -30.0], [x_mm + far, y_mm - 2.0]]
    return Polygon(np.array(corners), level)


def negative(view: View) -> View:
    """The same part, dark before a bright ground."""
    one, two = (edge._replace(bright_left=not edge.bright_left) for edge in view.features)
    return view._replace(pixels=255 - view.pixels, features=(one, two))


@pytest.mark.parametrize("edge", [1, 2])
@pytest.mark.parametrize("left_mm", [0.03, 0.05, 0.07, 0.10])
def test_a_battery_of_which_a_strip_leaves_only_the_rim_free_is_refused(edge: int, left_mm: float) -> None:
    """The strip's inner border is the better line, but outside a battery's edge there is no other one."""
    view = battery_view(np.random.default_rng(32), over=[strip_along(edge, left_mm)])

    for seen in (view, negative(view)):
        assert refusal(seen, "battery") == f"edge {edge} rival"


def test_a_thing_that_sticks_out_over_a_third_of_an_edge_hides_no_battery() -> None:
    """It has an outer border as strong as the edge, but only over a third of it."""
    left, right, inner, outer = -24.0, -20.7, -42.5 + 0.3, -42.5 - 0.3
    lid = Polygon(np.array([[left, inner], [right, inner], [right, outer], [left, outer]]), 200.0)
    view = battery_view(np.random.default_rng(33), over=[lid])

    for seen in (view, negative(view)):
        assert math.dist(seen.battery().corner, view.truth[0]) < 1.0


def test_a_base_of_which_a_strip_leaves_only_the_rim_free_is_refused() -> None:
    inner, outer = EDGE_MM - 0.5, EDGE_MM - 0.066
    strip = Polygon(np.array([[-9.0, inner], [9.0, inner], [9.0, outer], [-9.0, outer]]), 50.0)

    assert refusal(base_view(np.random.default_rng(34), over=[strip])) == "hole to edge"


@pytest.mark.parametrize("radius_mm", [2.75, 2.88, 3.12, 3.3])
def test_a_hole_of_another_radius_is_refused(radius_mm: float) -> None:
    view = base_view(np.random.default_rng(15), drawing=BaseDrawing(hole_radius_mm=radius_mm))

    assert refusal(view) in {"hole radius", "hole rival", "hole"}


def test_an_edge_at_another_distance_from_the_hole_is_refused() -> None:
    view = base_view(np.random.default_rng(16), drawing=BaseDrawing(edge_distance_mm=6.3))

    assert refusal(view) == "hole to edge"


def test_a_picture_without_light_is_refused() -> None:
    dark = Camera(exposure=0.02)

    assert refusal(base_view(np.random.default_rng(17), dark)) == "light"
    assert refusal(battery_view(np.random.default_rng(17), dark), "battery") == "light"


def test_a_picture_with_light_and_shade_but_no_outline_is_refused() -> None:
    view, held = base_view(np.random.default_rng(31)), battery_view(np.random.default_rng(31))
    height, width = view.pixels.shape
    shade = np.tile(np.linspace(30.0, 220.0, width).astype(np.uint8), (height, 1))

    assert refusal(view._replace(pixels=shade)) == "hole"
    assert refusal(held._replace(pixels=shade), "battery") == "edge 1"
    with pytest.raises(NotFound, match="no straight edge"):
        find_edge(shade, view.features[1], view.search, view.limits)


def test_an_over_exposed_picture_is_refused() -> None:
    bright = Camera(exposure=2.6)

    assert refusal(base_view(np.random.default_rng(18), bright)) == "saturation"
    assert refusal(battery_view(np.random.default_rng(18), bright), "battery") == "saturation"


def test_a_part_that_is_away_is_refused() -> None:
    view, held = base_view(np.random.default_rng(19)), battery_view(np.random.default_rng(19))
    empty = render(Scene(45.0, []), view.optics, np.random.default_rng(20))

    assert refusal(view._replace(pixels=empty)) == "contrast"
    assert refusal(held._replace(pixels=empty), "battery") == "contrast"


def test_a_part_further_away_than_the_search_is_refused() -> None:
    assert refusal(base_view(np.random.default_rng(21), place=Place(3.0, 0.0))) == "hole"


def test_the_wrong_polarity_is_refused() -> None:
    view = base_view(np.random.default_rng(22))
    held = battery_view(np.random.default_rng(22))

    assert refusal(view._replace(pixels=255 - view.pixels)).startswith("hole")
    limits = replace(held.limits, min_contrast=40.0)  # above that of the battery's own seam
    assert refusal(held._replace(pixels=255 - held.pixels, limits=limits), "battery")


def test_a_hole_that_is_largely_covered_is_refused() -> None:
    lid = Polygon(np.array([[-4.0, -4.0], [4.0, -4.0], [4.0, 2.4], [-4.0, 2.4]]), 130.0)

    assert refusal(base_view(np.random.default_rng(23), over=[lid])).startswith("hole")


def test_a_battery_that_is_not_square_is_refused() -> None:
    view = battery_view(np.random.default_rng(24))
    one, two = view.features
    skewed = ExpectedEdge(two.start, Px(two.end.u + 0.008 * (two.end.v - two.start.v), two.end.v), two.bright_left)

    assert refusal(view._replace(features=(one, skewed)), "battery") == "squareness"


def test_an_angle_that_is_too_uncertain_is_refused() -> None:
    view = base_view(np.random.default_rng(25))

    assert refusal(view._replace(limits=replace(view.limits, max_angle_sd_deg=1e-5))) == "edge angle"


def test_a_hole_at_the_border_of_the_picture_is_refused() -> None:
    view = base_view(np.random.default_rng(26))
    circle, edge = view.features

    assert refusal(
        view._replace(
            pixels=np.ascontiguousarray(view.pixels[:, 1050:]),
            features=(circle._replace(centre=Px(circle.centre.u - 1050, circle.centre.v)), edge),
        )
    ) in {"view", "hole"}


# -- junk -----------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(junk=JUNK, repeat=st.integers(1, 60), u=st.floats(-500, 900), v=st.floats(-500, 900), radius=st.floats(-10, 300))
def test_junk_is_refused_in_words(junk: np.ndarray, repeat: int, u: float, v: float, radius: float) -> None:
    pixels = np.repeat(np.repeat(junk, repeat, axis=0), repeat, axis=1) if junk.ndim > 1 else junk
    circle = ExpectedCircle(Px(u, v), radius, True)
    edges = ExpectedEdge(Px(u, v), Px(u + 300.0, v), True), ExpectedEdge(Px(u, v), Px(u, v + 300.0), False)
    limits = Limits(corner_skip_px=20.0, min_contrast=5.0, min_inliers=0.0, max_residual_px=99.0)

    for find, features in ((find_base, (circle, edges[0])), (find_battery, edges)):
        with contextlib.suppress(NotFound, ValueError):  # anything else is a fault
            find(pixels, *features, Search(50.0, 3.0), limits)


@settings(max_examples=60, deadline=None)
@given(
    size=st.tuples(st.integers(64, 420), st.integers(64, 420)),
    at=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
    turn_deg=st.floats(-180, 180),
    skip_px=st.sampled_from([0.0, 20.0, 60.0]),
)
def test_a_corner_in_a_picture_of_any_size_is_found_or_refused_in_words(
    size: tuple[int, int], at: tuple[float, float], turn_deg: float, skip_px: float
) -> None:
    height, width = size
    corner = Px(at[0] * width, at[1] * height)
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    v, u = np.mgrid[:height, :width].astype(float)
    along, across = (u - corner.u) * c + (v - corner.v) * s, (v - corner.v) * c - (u - corner.u) * s
    pixels = np.where((along > 0) & (across > 0), 150, 40).astype(np.uint8)
    ends = Px(corner.u + 300.0 * c, corner.v + 300.0 * s), Px(corner.u - 300.0 * s, corner.v + 300.0 * c)
    edges = ExpectedEdge(corner, ends[0], False), ExpectedEdge(corner, ends[1], True)
    limits = Limits(corner_skip_px=skip_px, min_contrast=5.0, min_inliers=0.0, min_in_view=0.1)

    for look in (
        lambda: find_battery(pixels, *edges, Search(30.0, 2.0), limits),
        lambda: find_edge(pixels, edges[0], Search(30.0, 2.0), limits),
    ):
        with contextlib.suppress(NotFound):  # anything else is a fault
            look()


@pytest.mark.parametrize(
    "junk", [None, 3, "picture", [[1, 2], [3, 4]], np.zeros((100, 100)), np.zeros((20, 200), np.uint8)]
)
def test_what_is_no_picture_is_a_value_error(junk: object) -> None:
    view, held = base_view(np.random.default_rng(27)), battery_view(np.random.default_rng(27))
    for finding in (view, held):
        with pytest.raises(ValueError, match="a picture must be"):
            finding._replace(pixels=junk).base() if finding is view else finding._replace(pixels=junk).battery()


@pytest.mark.parametrize(
    ("circle", "edge", "search"),
    [
        (ExpectedCircle(Px(math.nan, 0.0), 400.0, True), None, BASE_SEARCH),
        (ExpectedCircle(Px(900.0, 900.0), 0.0, True), None, BASE_SEARCH),
        (None, ExpectedEdge(Px(5.0, 5.0), Px(5.0, 5.0), True), BASE_SEARCH),
        (None, None, Search(-1.0, 2.0)),
        (None, None, Search(100.0, math.inf)),
    ],
)
def test_a_senseless_expectation_is_a_value_error(
    circle: ExpectedCircle | None, edge: ExpectedEdge | None, search: Search
) -> None:
    view = base_view(np.random.default_rng(28))
    features = (circle or view.features[0], edge or view.features[1])

    with pytest.raises(ValueError, match=r"expected|search|direction"):
        view._replace(features=features, search=search).base()


def test_two_expected_edges_must_make_a_corner() -> None:
    edge = ExpectedEdge(Px(0.0, 0.0), Px(500.0, 0.0), True)
    for other in (
        edge,
        ExpectedEdge(Px(1.0, 0.0), Px(1.0, 500.0), False),
        ExpectedEdge(Px(0.0, 0.0), Px(0.0, 9.0), True),
    ):
        with pytest.raises(ValueError, match="corner"):
            find_battery(np.zeros((600, 600), np.uint8), edge, other, BATTERY_SEARCH, Limits())


def test_measuring_changes_neither_the_picture_nor_its_own_answer() -> None:
    view = base_view(np.random.default_rng(29))
    before = view.pixels.copy()
    view.pixels.flags.writeable = False
    first, second = view.base(), view.base()

    assert first == second
    assert isinstance(first.edge, Edge)
    assert np.array_equal(view.pixels, before)
