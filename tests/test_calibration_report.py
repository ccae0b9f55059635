"""The quality report of a calibration, as text and as a picture."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cellctl.calibration.board import DotBoard
from cellctl.calibration.hand_eye import HandEye
from cellctl.calibration.parameters import PARAMETERS
from cellctl.calibration.report import Acceptance, coverage, report_text, shortcomings
from cellctl.calibration.report_picture import Past, report_picture
from tests.calibration_cells import calibrated, planned, solved, true_cell


@pytest.fixture(scope="module")
def found() -> HandEye:
    return calibrated(true_cell("eye_in_hand", 1), 1)


def test_the_report_has_every_figure_and_says_what_is_not_known(found):
    text = report_text(found)
    for figure in (
        f"{found.rms_px:.4f} px rms",
        "rotation spread 50.0 deg",
        f"{found.hold_out_um:.1f} um",
        "mirrored: ",
    ):
        assert figure in text
    assert "z is not observable" in text
    assert "NOT GOOD" not in text
    assert json.loads(json.dumps(found.as_dict()))["note"] == found.note
    assert found.covariance.shape == (len(PARAMETERS), len(PARAMETERS))


def test_the_report_says_what_is_not_good_enough(found):
    assert shortcomings(found) == ()
    assert [s.split(" is ")[0] for s in shortcomings(found, Acceptance(rms_px=0.001, hold_out_um=0.1))] == [
        "the dots' residual",
        "the hold-out error",
    ]
    assert "NOT GOOD" in report_text(replace(found, hold_out_um=math.nan))
    assert "NOT GOOD" in report_text(found, Acceptance(hold_out_um=0.1))


def test_the_report_has_a_row_for_every_pose(found):
    rows = report_text(found).splitlines()[-len(found.poses) :]
    assert [row.split()[0] for row in rows] == [str(number) for number in range(1, len(found.poses) + 1)]
    assert [row.split()[-1] == "worst" for row in rows].index(True) == found.worst_pose


def test_the_picture_shows_residuals_poses_and_the_history_of_the_figures(found):
    past = [Past("26-11-20", 9.0, 5.0, False), Past("26-11-21", 60.0, 5.0, True), Past("26-11-22", 8.0, 4.0, False)]
    picture = report_picture(found, past)
    assert picture.dtype == np.uint8
    assert picture.shape == (706, 1324, 3)
    shaded = np.mean(np.any(picture[:648, :864] != 250, axis=2))
    assert shaded > 0.7 * coverage(found)
    red = np.all(picture == (40, 40, 210), axis=2)
    assert red[:648, :864].any()  # the arrows of the worst pose
    assert red[:353, 864:].any()  # the worst pose
    assert red[353:, 864:].any()  # the refused version
    alone = report_picture(found, past[:1])
    assert not np.array_equal(alone[353:, 864:], picture[353:, 864:])
    assert np.array_equal(alone[:, :864], picture[:, :864])


@given(st.floats(0.1, 2), st.floats(0.1, 2), st.floats(0.1, 2))
@settings(max_examples=30, deadline=None)
def test_a_board_that_cannot_be_printed_is_refused(dot, origin, pitch):
    assume(not 1.15 * dot <= origin <= 0.85 * pitch)
    with pytest.raises(ValueError, match="dot board"):
        DotBoard(dot_mm=dot, origin_dot_mm=origin, pitch_mm=pitch)


def test_what_was_left_out_is_in_the_report_and_poses_keep_their_numbers():
    cell = true_cell("eye_in_hand", 12)
    poses, rng = planned(cell), np.random.default_rng(2)
    dots = cell.see(poses, rng)
    dots[3] += 40
    dots[8, 5] += 3
    text = report_text(solved("eye_in_hand", poses, dots))
    assert "pose 4: the board is seen" in text
    assert "1 single dots that lie off" in text
    numbers = [int(row.split()[0]) for row in text.splitlines()[-14:]]
    assert numbers == [1, 2, 3, *range(5, 16)]
