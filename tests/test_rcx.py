"""RCX text and values, and the model of the arm's reach."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import rcx
from drivers.rcx import (
    LEFTY,
    RIGHTY,
    Arch,
    Code,
    Kind,
    Mode,
    Motion,
    Point,
    Ramps,
    RobotStatus,
    classify,
)
from drivers.rcx2 import Rcx2
from drivers.rcx3 import Rcx3, parse_alarm, parse_flag
from drivers.rcx_codes import RCX2, RCX3, meaning
from drivers.rcx_points import StoredPoint, parse_point, parse_points, point_line
from drivers.robot_files import parse_task

NEW, OLD = Rcx3(), Rcx2()
READY = RobotStatus(mode=Mode.AUTOMATIC, emergency_stop=False, alarm="", motor_on=True, servo_on=True, origin_done=True)


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
    assert meaning(RCX3, 12, 600) == "emergency stop on"
    assert meaning(RCX3, 6, 999) == "language execution, see the controller's manual"
    assert meaning(RCX2, 77, 1) == "unknown group, see the controller's manual"
    assert all(text and text[-1] != "." for table in (RCX2, RCX3) for text in table.values())
    assert NEW.meaning(Code(2, 334)) == OLD.meaning(Code(2, 1)) == "soft limit over"


@pytest.mark.parametrize(
    "code", [Code(5, 30), Code(5, 52), Code(6, 4), Code(4, 8), Code(3, 3), Code(14, 22), Code(6, 63)]
)
def test_in_five_groups_the_older_class_is_two_hundred_lower(code):
    assert OLD.meaning(code) == NEW.meaning(Code(code.group, code.number + 200))


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
    assert parse_flag(line) is value


@pytest.mark.parametrize(
    ("line", "value"), [("2", 2), (" -1 ", -1), ("\x1f2", 2), ("2.0", None), ("", None), ("\xb2", None)]
)
def test_a_whole_number_stands_alone(line, value):
    assert rcx.parse_integer(line) == value


def test_status_answers_are_read_together():
    answers = ("2", "0", "0.0", "2", "1 1,1,1,1", "1 1,1,1,1")

    assert NEW.status(answers) == READY
    assert NEW.status((*answers[:2], "NG", *answers[3:])) is None
    assert NEW.status(("-1", "1", "12.600", "0", "0 0,0,0,0", "0 0,1,1,1")) == RobotStatus(
        mode=Mode.OTHER,
        emergency_stop=True,
        alarm="12.600",
        motor_on=False,
        servo_on=False,
        origin_done=False,
        alarm_means="emergency stop on",
    )


def test_an_older_controller_tells_its_state_by_words_and_its_alarm_by_an_output_and_the_last_message():
    answers = ("AUTO", "OFF", "ON,99991111", "COMPLETE", "6")

    assert OLD.more_queries(answers) == ()
    assert OLD.status(answers) == READY
    stopped = ("MANUAL", "ON", "OFF,99990000", "INCOMPLETE,99990111", "11")
    assert OLD.more_queries(stopped) == ("MSG",)
    status = OLD.status((*stopped, "12.1:\xcb\xbc\xde"))
    assert status == RobotStatus(Mode.MANUAL, True, "12.1", False, False, False, "emergency stop on")
    assert OLD.status((*stopped, "what?")).alarm == "?"
    for k in range(5):
        assert OLD.status((*answers[:k], "\xb1", *answers[k + 1 :])) is None


def test_a_ready_robot_has_no_excuse_and_an_unready_one_a_remedy():
    assert READY.ready
    assert READY.why_not_ready == ""
    stopped = RobotStatus(Mode.AUTOMATIC, True, "12.600", False, False, True)
    assert not stopped.ready
    assert "release it" in stopped.why_not_ready
    alarmed = RobotStatus(Mode.AUTOMATIC, False, "17.910", False, False, True, "position deviation")
    assert "17.910 (position deviation)" in alarmed.why_not_ready
    assert "mode is manual" in RobotStatus(Mode.MANUAL, False, "", True, True, True).why_not_ready


def test_a_move_is_written_with_the_generations_decimals_in_all_six_fields():
    motion = Motion(Point(250, -0.0001, 20.12345, -90), LEFTY, 50)

    assert NEW.move(motion) == ((), "@MOVE P,250.000 0.000 20.123 -90.000 0.000 0.000 2,S=50")
    assert OLD.move(motion) == (("@LEFTY",), "@MOVE P,250.00 0.00 20.12 -90.00 0.00 0.00,S=50")
    line = motion._replace(straight=True, ramps=Ramps(40, 30), blends=True)
    assert OLD.move(line).operation == "@MOVE L,250.00 0.00 20.12 -90.00 0.00 0.00,S=50,ACC=40,DEC=30,CONT"


def test_an_arch_is_written_as_each_generation_has_it():
    motion = Motion(Point(250, 0, 20, 0), RIGHTY, 50, arch=Arch(5))

    assert NEW.move(motion).operation.endswith(" 1,A3=5.000{0.000,0.000},S=50")
    assert OLD.move(motion).operation.endswith(" 0.00,Z=5.00,S=50")
    with pytest.raises(ValueError, match="height only"):
        OLD.move(motion._replace(arch=Arch(5, 1, 1)))


def test_a_move_too_long_for_a_line_goes_by_the_last_point_of_the_table():
    motion = Motion(Point(-250, -200, 120, -180), RIGHTY, 100, False, Ramps(50, 50), Arch(100, 20, 20))

    settings, operation = NEW.move(motion)
    assert settings == ("@P29999=-250.000 -200.000 120.000 -180.000 0.000 0.000 1",)
    assert operation == "@MOVE P,P29999,A3=100.000{20.000,20.000},S=100,ACC=50,DEC=50"


@given(
    st.builds(Point, *[st.floats(-999.9, 999.9)] * 4),
    st.sampled_from([RIGHTY, LEFTY]),
    st.integers(1, 100),
    st.booleans(),
    st.builds(Ramps, st.integers(1, 100), st.integers(1, 100)),
    st.none() | st.floats(0, 150).map(Arch),
)
def test_a_move_fits_the_line_and_says_what_was_meant(to, hand, speed_pct, straight, ramps, arch):
    for dialect, within in ((NEW, 0.00051), (OLD, 0.0051)):
        settings, operation = dialect.move(Motion(to, hand, speed_pct, straight, ramps, arch))
        lines = [*settings, operation]
        assert all(len(line) <= 80 and line.startswith("@") for line in lines)
        said = operation.split(",")[1]
        said = next((line.partition("=")[2] for line in settings if line.startswith(f"@{said}=")), said)
        position = rcx.parse_position(said)
        assert position is not None
        assert position.point == pytest.approx(to, abs=within)
        assert position.hand == hand if dialect is NEW else settings[0] == f"@{'RIGHTY' if hand == RIGHTY else 'LEFTY'}"


@pytest.mark.parametrize("dialect", [NEW, OLD])
@pytest.mark.parametrize("by", [0.0, 0.0004, 10.001, float("nan"), float("inf")])
def test_a_step_that_is_none_is_refused(dialect, by):
    with pytest.raises(ValueError, match=r"a step of|NaN"):
        dialect.inch(1, by)


def test_jogs_and_steps_name_axes_as_each_generation_does():
    assert NEW.jog(2, -1) == ((), "@JOGXY 2-")
    assert OLD.jog(2, -1) == (("@UNIT 1",), "@JOG Y-")
    assert NEW.inch(4, 0.25) == (("@IDIST 250",), "@INCHXY 4+")
    assert OLD.inch(3, -1) == (("@UNIT 1", "@IDIST 1000"), "@INCH Z-")


def test_the_payload_is_said_in_grams_or_in_whole_kilograms_never_less():
    assert NEW.payload(1.25) == ("WEIGHTG 1250", "WEIGHTG", 1250)
    assert OLD.payload(1.25) == ("WEIGHT 2", "WEIGHT", 2)


@pytest.mark.parametrize(
    ("text", "point"),
    [
        ("1.0 2.0 3.0 4.0 0.0 0.0 1 0 0", StoredPoint((1, 2, 3, 4, 0, 0), False, 1)),
        ("   1.00    2.00    3.00    4.00    0.00    0.00", StoredPoint((1, 2, 3, 4, 0, 0), False)),
        ("1000 -2000 3000 4000 0 0", StoredPoint((1000, -2000, 3000, 4000, 0, 0), True)),
        ("1 2.5 3 4 0 0 2", StoredPoint((1, 2.5, 3, 4, 0, 0), False, 2)),
        ("1.0 2.0 3.0 4.0 0.0 0.0 1 -1 2", StoredPoint((1, 2, 3, 4, 0, 0), False, 1, (-1, 2))),
        ("1.0 2.0 3.0", None),
        ("1.0 2.0 3.0 4.0 0.0 x", None),
        ("1.0 2.0 3.0 4.0 0.0 0.0 3", None),
        ("1.0 2.0 3.0 4.0 0.0 0.0 1.0", None),
    ],
)
def test_a_stored_point_is_in_pulses_when_no_number_has_a_decimal_point(text, point):
    assert parse_point(text) == point


@given(
    st.integers(0, 9999),
    st.tuples(*[st.integers(-99999, 99999)] * 6),
    st.booleans(),
    st.integers(0, 2),
    st.sampled_from([NEW, OLD]),
)
def test_points_survive_writing_and_reading(number, counts, in_pulses, hand, dialect):
    point = StoredPoint(tuple(float(n) if in_pulses else n / 100 for n in counts), in_pulses, hand)

    assert parse_points([point_line(number, point, dialect)]) == {number: point}


def test_a_point_that_there_cannot_be_is_refused():
    point = StoredPoint((1.0,) * 6, False)
    with pytest.raises(ValueError, match=r"P10000 is outside P0 \.\. P9999"):
        point_line(10000, point, OLD)
    with pytest.raises(ValueError, match="nan is no length"):
        point_line(1, point._replace(values=(float("nan"),) * 6), NEW)
    with pytest.raises(ValueError, match="'hello' is no point"):
        parse_points(["P1=1.0 2.0 3.0 4.0 0.0 0.0", "hello"])


@pytest.mark.parametrize("text", ["X" * 80, "MOVE\r\n", "\x03", "?\xe9"])
def test_a_command_that_cannot_be_sent_is_refused(text):
    with pytest.raises(ValueError, match="no command"):
        rcx.command(text)


def test_a_target_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="no length or angle"):
        NEW.move(Motion(Point(float("nan"), 0, 0, 0), RIGHTY, 50))


PARSERS = [
    *(rcx.parse_failure, rcx.parse_position, rcx.parse_pulses, rcx.parse_integer, rcx.parse_leading_integer),
    *(rcx.parse_byte, rcx.parse_flag_alone, rcx.parse_hand, parse_flag, parse_alarm, parse_point, parse_task, classify),
]


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
