"""The lens benchmark in short: it runs, and its rows say what it promises."""

import numpy as np

from cellctl.calibration.lens.boards import Chessboard
from tests.benchmarks.bench_lens import compare, lens_error_px, table
from tests.lens_scenes import CAMERA, photograph, some_places


def test_on_rendered_pictures_the_lens_is_better_known_than_by_opencvs_corners():
    board, rng = Chessboard(9, 6, 10.0), np.random.default_rng(1)
    pictures = [photograph(board, CAMERA, place, rng) for place in some_places(rng, CAMERA, board, 5)]
    ours, *theirs = compare("short", board, pictures, CAMERA.truth)
    assert ours["lens_error_px"] < 0.3 * min(row["lens_error_px"] for row in theirs)
    assert ours["rms_px"] < 0.5 * min(row["rms_px"] for row in theirs)
    assert len(table([ours, *theirs]).splitlines()) == 4


def test_the_true_lens_has_no_error_and_a_longer_one_has():
    assert lens_error_px(CAMERA.truth, CAMERA.truth, CAMERA.picture_px) < 1e-9
    longer = CAMERA.truth * ([1.001] * 2 + [1.0] * 7)
    assert 0.1 < lens_error_px(longer, CAMERA.truth, CAMERA.picture_px) < 0.5
