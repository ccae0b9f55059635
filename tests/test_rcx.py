"""RCX text and values, and the model of the arm's reach."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import rcx
from drivers.rcx import LEFTY, RIGHTY, Code, Kind, Point, RobotStatus, classify
from drivers.rcx_codes import CODES, meaning
from drivers.reach import Limits

READY = RobotStatus(mode=2, emergency_stop=False, alarm="", motor_on=True, servo_on=True, origin_done=True)


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("", Kind.NOTHING),
        ("  ", Kind.NOTHING),
        ("Welcome to RCX340", Kind.NOTHING),
        ("Welcome to RCX320", Kind.NOTHING),
        ("OK", Kind.OK),
        (" RUN ", Kind.RUN),
        ("END", Kind.END),
        ("READY", Kind.READY),
        ("BEGIN", Kind.BEGIN),
        ("NG=6.204", Kind.FAILURE),
        ("NG=", Kind.FAILURE),
        ("5.30:\xb1\xb2", Kind.FAILURE),
        ("0.0", Kind.DATA),
        ("OKAY", Kind.DATA),
        ("250.000 0.000 0.000 0.000 0.000 0.000 1 0 0", Kind.DATA),
    ],
)
def test_each_line_is_classified(line, kind):
    assert classify(line) is kind


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("NG=6.204", "6.204"),
        ("NG=06.204", "6.204"),
        ("NG= 0.21", "0.21"),
        ("NG=12.600", "12.600"),
        ("12.600", "12.600"),
        ("5.30:\xb1\xb2", "5.30"),
        ("NG=", None),
        ("NG=x.y", None),
        ("NG=6.2042", None),
        ("OK", None),
    ],
)
def test_a_failure_is_read_padded_or_not(line, code):
    found = rcx.parse_failure(line)

    assert (str(found) if found else None) == code


def test_every_code_is_readable_known_or_not():
    assert meaning(12, 600) == "emergency stop on"
    assert meaning(6, 999) == "language execution, see the controller's manual"
    assert meaning(77, 1) == "unknown group, see the controller's manual"
    assert all(text and text[-1] != "." for text in CODES.values())
    assert Code(2, 334).meaning == "soft limit over"


@pytest.mark.parametrize(
    ("line", "point", "hand"),
    [
        ("300.000 0.000 10.000 -5.500 0.000 0.000 1 0 0", (300, 0, 10, -5.5), RIGHTY),
        ("300.000 0.000 10.000 -5.500 0.000 0.000 2", (300, 0, 10, -5.5), LEFTY),
        ("300.00 0.00 10.00 -5.50 0.00 0.00", (300, 0, 10, -5.5), 0),
        ("[POS]  300.00   -0.50   10.00   -5.50    0.00    0.00", (300, -0.5, 10, -5.5), 0),
        ("[POS] 300.00 -0.50 10.00 -5.50 0.00 0.00 1 0 0", (300, -0.5, 10, -5.5), RIGHTY),
    ],
)
def test_a_position_line_has_six_seven_or_nine_fields(line, point, hand):
    position = rcx.parse_position(line)

    assert position is not None
    assert position.point == point
    assert position.hand == hand


@pytest.mark.parametrize(
    "line",
    [
        "",
        "OK",
        "1 2 3 4 5",
        "1 2 3 4 5 6 1 0",
        "1 2 3 4 5 nan",
        "inf 2 3 4 5 6",
        "1e3 2 3 4 5 6",
        "1_0 2 3 4 5 6",
        "1,2,3,4,5,6",
        "1 2 3 4 5 6 3",
        "\u0663 2 3 4 5 6",
    ],
)
def test_what_is_no_position_is_none(line):
    assert rcx.parse_position(line) is None


@pytest.mark.parametrize(
    ("line", "value"),
    [("1 1,1,1,1", True), ("0 1,1,0,1", False), ("1", True), ("0", False), ("2", None), ("1 x", None)],
)
def test_a_flag_is_the_first_digit(line, value):
    assert rcx.parse_flag(line) is value


@pytest.mark.parametrize(
    ("line", "value"), [("2", 2), (" -1 ", -1), ("\x1f2", 2), ("2.0", None), ("", None), ("\xb2", None)]
)
def test_a_whole_number_stands_alone(line, value):
    assert rcx.parse_integer(line) == value


def test_status_answers_are_read_together():
    answers = ("2", "0", "0.0", "2", "1 1,1,1,1", "1 1,1,1,1")

    assert rcx.parse_status(answers) == READY
    assert rcx.parse_status((*answers[:2], "NG", *answers[3:])) is None
    assert rcx.parse_status(("-1", "1", "12.600", "0", "0 0,0,0,0", "0 0,1,1,1")) == RobotStatus(
        mode=-1, emergency_stop=True, alarm="12.600", motor_on=False, servo_on=False, origin_done=False
    )


def test_a_ready_robot_has_no_excuse_and_an_unready_one_a_remedy():
    assert READY.ready
    assert READY.why_not_ready == ""
    stopped = RobotStatus(2, True, "12.600", False, False, True)
    assert not stopped.ready
    assert "release it" in stopped.why_not_ready
    alarmed = RobotStatus(2, False, "17.910", False, False, True)
    assert "17.910 (position deviation" in alarmed.why_not_ready
    assert "mode is 0" in RobotStatus(0, False, "", True, True, True).why_not_ready


def test_a_move_is_written_with_three_decimals_in_all_six_fields():
    line = rcx.move(Point(250, -0.0001, 20.12345, -90), hand=RIGHTY, speed_pct=50, straight=False)

    assert line == "@MOVE P,250.000 0.000 20.123 -90.000 0.000 0.000 1,S=50"
    assert rcx.move(Point(1, 2, 3, 4), hand=LEFTY, speed_pct=1, straight=True).startswith("@MOVE L,1.000 ")


@given(
    st.builds(Point, *[st.floats(-999.9, 999.9)] * 4),
    st.sampled_from([RIGHTY, LEFTY]),
    st.integers(1, 100),
    st.booleans(),
)
def test_a_move_fits_the_line_and_says_what_was_meant(to, hand, speed_pct, straight):
    line = rcx.move(to, hand=hand, speed_pct=speed_pct, straight=straight)

    assert len(line) <= 80
    position = rcx.parse_position(line.split(",")[1])
    assert position is not None
    assert position.point == pytest.approx(to, abs=0.00051)
    assert position.hand == hand


@pytest.mark.parametrize("text", ["X" * 80, "MOVE\r\n", "\x03", "?\xe9"])
def test_a_command_that_cannot_be_sent_is_refused(text):
    with pytest.raises(ValueError, match="no command"):
        rcx.command(text)


def test_a_target_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="no position"):
        rcx.move(Point(float("nan"), 0, 0, 0), hand=RIGHTY, speed_pct=50, straight=False)


PARSERS = [rcx.parse_failure, rcx.parse_position, rcx.parse_integer, rcx.parse_flag, rcx.parse_alarm, classify]


@given(st.text(st.characters(max_codepoint=255), max_size=60))
def test_no_text_breaks_a_parser(line):
    for parse in PARSERS:
        parse(line)


def test_twenty_thousand_lines_of_noise_break_no_parser():
    rng = random.Random(20261122)
    words = ["OK", "NG=", "6.204", "[POS]", "1 1,1,1,1", "250.000", "-", "+.", ".", " ", "Welcome", "END", "\xb1", "e9"]
    read = 0
    for _ in range(20_000):
        line = "".join(rng.choice(words) if rng.random() < 0.7 else chr(rng.randrange(256)) for _ in range(9))
        read += sum(parse(line) is not None for parse in PARSERS)
    assert read >= 20_000  # classify always says something


# -- reach ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("target", "complaint"),
    [
        (Point(400, 0, 0, 0), "reach 400.000 mm is outside 133 .. 399.5 mm"),
        (Point(100, 0, 0, 0), "reach 100.000 mm"),
        (Point(300, 0, 151, 0), "z 151.000 mm"),
        (Point(300, 0, -1, 0), "z -1.000 mm"),
        (Point(300, 0, 0, 361), "r 361.000 deg"),
        (Point(-300, 0, 0, 0), "axis 1"),
        (Point(250, 0, 0, -330), "axis 4"),
        (Point(float("nan"), 0, 0, 0), "no position"),
    ],
)
def test_a_target_out_of_bounds_is_named_with_its_numbers(target, complaint):
    assert complaint in Limits().objection(target, hand=RIGHTY)


@pytest.mark.parametrize(
    "target", [Point(282, 120, 100, 0), Point(200, -220, 110, 0), Point(150, 250, 105, 0), Point(300, -120, 80, 90)]
)
def test_the_cells_places_are_within_bounds(target):
    assert Limits().objection(target, hand=RIGHTY) == ""


def test_a_line_past_the_column_is_out_of_bounds():
    limits = Limits()

    assert "passes 0.0 mm from the column" in limits.objection_to_line(Point(0, -200, 0, 0), Point(0, 200, 0, 0))
    assert limits.objection_to_line(Point(200, -200, 0, 0), Point(200, 200, 0, 0)) == ""
    assert limits.objection_to_line(Point(200, 0, 0, 0), Point(200, 0, 50, 0)) == ""
