"""The simulated conveyor: a belt with inertia, scattered carriers, a switch that chatters, a clamp that takes time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.belt import COAST_DOWN_MM_S2, SPEED_MM_S, SPEED_UP_MM_S2, Belt
from simulators.conveyor import APART_MM, APART_SCATTER_MM, BOUNCE_S, CLAMP_S, LEAVE_MM, Conveyor, Fault


class Time:
    """World time that stands still until told otherwise."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def conveyor(seed: int = 1) -> tuple[Time, Conveyor]:
    time = Time()
    return time, Conveyor(time, np.random.default_rng(seed))


def run_until(time: Time, made: Conveyor, event: str, within_s: float = 3.0) -> float:
    """World time at which it happened, to a millisecond."""
    for _ in range(round(within_s * 1000)):
        if made.step() == event:
            return time.now_s
        time.now_s += 0.001
    raise AssertionError(f"{event} did not happen within {within_s} s")


def bring(time: Time, made: Conveyor) -> None:
    made.drive(True)
    run_until(time, made, "arrived")
    made.drive(False)
    made.clamp(True)
    time.now_s += 1.0


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.floats(0.0, 0.5)), max_size=8))
def test_the_way_is_the_integral_of_the_speed_whatever_the_motor_does(orders: list[tuple[bool, float]]) -> None:
    time = Time()
    belt = Belt(time)
    summed_mm, step_s = 0.0, 0.002
    for on, for_s in orders:
        belt.aim(SPEED_MM_S if on else 0.0)
        for _ in range(round(for_s / step_s)):
            before_mm_s = belt.speed_mm_s()
            time.now_s += step_s
            after_mm_s = belt.speed_mm_s()
            assert 0.0 <= after_mm_s <= SPEED_MM_S
            assert -COAST_DOWN_MM_S2 * step_s - 1e-6 <= after_mm_s - before_mm_s <= SPEED_UP_MM_S2 * step_s + 1e-6
            summed_mm += (before_mm_s + after_mm_s) / 2 * step_s
    assert belt.ran_mm() == pytest.approx(summed_mm, abs=0.02 * (1 + len(orders)))


@settings(max_examples=50, deadline=None)
@given(st.floats(0.05, 0.4), st.floats(0.0, 60.0))
def test_the_time_at_which_a_way_is_run_is_exact_while_speeding_up_and_coasting_down(on_s: float, mm: float) -> None:
    time = Time()
    belt = Belt(time)
    belt.aim(SPEED_MM_S)
    time.now_s = on_s
    there_s = belt.reaches_s(mm)
    time.now_s = there_s
    assert belt.ran_mm() == pytest.approx(mm, abs=1e-6)
    time.now_s = on_s
    belt.aim(0.0)
    coasted_mm = belt.ran_mm() + belt.speed_mm_s() ** 2 / (2 * COAST_DOWN_MM_S2)
    there_s = belt.reaches_s(coasted_mm - 0.5)
    assert math.isinf(belt.reaches_s(coasted_mm + 0.5))
    time.now_s = there_s
    assert belt.ran_mm() == pytest.approx(coasted_mm - 0.5, abs=1e-6)


def test_a_belt_that_was_switched_off_coasts_on_and_then_stands() -> None:
    time, made = conveyor()
    made.drive(True)
    time.now_s = 0.4
    made.drive(False)
    time.now_s += SPEED_MM_S / COAST_DOWN_MM_S2 - 0.001
    assert made.moving
    time.now_s += 0.002
    assert not made.moving


def test_carriers_come_scattered_within_their_limits_and_leave_after_their_length() -> None:
    time, made = conveyor()
    ways_s = []
    bring(time, made)
    for _ in range(30):
        made.clamp(False)
        made.release()
        made.drive(True)
        began_s = time.now_s
        left_s = run_until(time, made, "left")
        assert left_s - began_s == pytest.approx(0.1 + LEAVE_MM / SPEED_MM_S, abs=0.002)
        came_s = run_until(time, made, "arrived")
        ways_s.append(came_s - left_s)
        made.drive(False)
        made.clamp(True)
        time.now_s += 0.5
    nominal_s, scatter_s = APART_MM / SPEED_MM_S, APART_SCATTER_MM / SPEED_MM_S
    assert min(ways_s) >= nominal_s - scatter_s - 0.002
    assert max(ways_s) <= nominal_s + scatter_s + 0.002
    assert max(ways_s) - min(ways_s) > scatter_s


def test_the_switch_chatters_when_a_carrier_comes_and_when_it_goes_never_longer_than_its_limit() -> None:
    for seed in range(20):
        time, made = conveyor(seed)
        for event, after in (("arrived", True), ("left", False)):
            made.clamp(False)
            made.release()
            made.drive(True)
            run_until(time, made, event)
            at_s, seen = time.now_s, []
            while time.now_s < at_s + 2 * BOUNCE_S:
                seen.append((time.now_s - at_s, made.photo_switch()))
                time.now_s += 0.0002
            assert {state for age_s, state in seen if age_s >= BOUNCE_S} == {after}
            assert (not after) in {state for _, state in seen}


def test_the_clamp_needs_its_time_and_holds_a_carrier_whose_pin_is_down() -> None:
    time, made = conveyor()
    made.drive(True)
    run_until(time, made, "arrived")
    made.clamp(True)
    assert not made.clamped
    time.now_s += CLAMP_S + 0.001
    assert made.clamped
    made.release()
    time.now_s += 2.0
    assert made.step() is None
    made.clamp(False)
    assert not made.clamped
    assert made.step() == "left"


@pytest.mark.parametrize(
    ("fault", "moves_driven", "moves_idle", "comes"),
    [("stuck", True, False, False), ("blocked", False, False, False), ("creeps", True, True, True)],
)
def test_each_fault_of_the_belt_shows_and_heals(
    fault: Fault, moves_driven: bool, moves_idle: bool, comes: bool
) -> None:
    time, made = conveyor()
    made.inject(fault)
    made.drive(True)
    time.now_s = 2.0
    assert made.moving is moves_driven
    assert (made.step() == "arrived") is comes
    made.drive(False)
    time.now_s = 3.0
    assert made.moving is moves_idle
    made.inject(fault, on=False)
    time.now_s = 4.0
    assert not made.moving
    if not comes:
        bring(time, made)
        assert made.occupied
