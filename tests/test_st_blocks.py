"""The standard function blocks against their definitions, worked out from the whole history of their inputs."""

from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.st.library import TimeBase
from simulators.st.machine import Machine
from tests.st_programs import machine

MS = 1000
Scans = list[tuple[int, bool]]
histories = st.lists(st.tuples(st.integers(0, 40), st.booleans()), max_size=40)


def played(block: str, scans: Scans, preset_ms: int = 50) -> list[tuple[int, bool, bool, int]]:
    """Time in ms, IN, Q and ET in ms of each scan."""
    time = TimeBase()
    made = machine(f"t(IN := input, PT := T#{preset_ms}ms);", f"VAR t : {block}; input : BOOL; END_VAR", time=time)
    seen = []
    for step_ms, on in scans:
        time.now_us += step_ms * MS
        made["input"] = on
        made.scan()
        seen.append((time.now_us // MS, on, bool(made["t.Q"]), int(made["t.ET"]) // MS))
    return seen


def on_since(seen: list[tuple[int, bool, bool, int]], at: int, state: bool) -> int | None:
    """Time of the first scan of the unbroken row of `state` that ends with this scan."""
    since = None
    for now_ms, on, _, _ in reversed(seen[: at + 1]):
        if on is not state:
            break
        since = now_ms
    return since


@settings(max_examples=50, deadline=None)
@given(histories)
def test_ton_is_on_as_soon_as_its_input_was_on_for_the_preset_time(scans: Scans) -> None:
    seen = played("TON", scans)
    for at, (now_ms, _, q, et_ms) in enumerate(seen):
        since_ms = on_since(seen, at, True)
        age_ms = 0 if since_ms is None else now_ms - since_ms
        assert q is (since_ms is not None and age_ms >= 50)
        assert et_ms == min(age_ms, 50)


@settings(max_examples=50, deadline=None)
@given(histories)
def test_tof_stays_on_for_the_preset_time_after_its_input_has_gone(scans: Scans) -> None:
    seen = played("TOF", scans)
    for at, (now_ms, on, q, et_ms) in enumerate(seen):
        since_ms = on_since(seen, at, False)
        was_on = any(before for _, before, _, _ in seen[:at])
        age_ms = 0 if since_ms is None or not was_on else now_ms - since_ms
        assert q is (on or (was_on and age_ms < 50))
        assert et_ms == min(age_ms, 50)


@settings(max_examples=50, deadline=None)
@given(histories)
def test_tp_gives_pulses_of_the_preset_time_that_nothing_shortens_or_prolongs(scans: Scans) -> None:
    begun_ms, before = -1000, False
    for now_ms, on, q, et_ms in played("TP", scans):
        if on and not before and now_ms - begun_ms >= 50:
            begun_ms = now_ms
        before = on
        assert q is (now_ms - begun_ms < 50)
        if q:
            assert et_ms == now_ms - begun_ms


@settings(max_examples=50, deadline=None)
@given(st.lists(st.booleans(), max_size=40))
def test_edges_are_seen_for_one_scan(levels: list[bool]) -> None:
    made = machine("r(CLK := x); f(CLK := x);", "VAR r : R_TRIG; f : F_TRIG; x : BOOL; END_VAR")
    before = False
    for level in levels:
        made["x"] = level
        made.scan()
        assert made["r.Q"] is (level and not before)
        assert made["f.Q"] is (before and not level)
        before = level


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=40))
def test_reset_wins_in_rs_and_set_wins_in_sr(scans: list[tuple[bool, bool]]) -> None:
    made = machine("a(S := x, R1 := y); b(S1 := x, R := y);", "VAR a : RS; b : SR; x, y : BOOL; END_VAR")
    reset_wins = set_wins = False
    for x, y in scans:
        made["x"], made["y"] = x, y
        made.scan()
        reset_wins = False if y else reset_wins or x
        set_wins = True if x else set_wins and not y
        assert made["a.Q1"] is reset_wins
        assert made["b.Q1"] is set_wins


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 9).map(lambda n: n == 0)), max_size=60))
def test_ctu_counts_edges_and_tells_when_the_preset_is_reached(scans: list[tuple[bool, bool]]) -> None:
    made = machine("c(CU := x, R := y, PV := 3);", "VAR c : CTU; x, y : BOOL; END_VAR")
    count, before = 0, False
    for x, y in scans:
        made["x"], made["y"] = x, y
        made.scan()
        count = 0 if y else count + (x and not before)
        before = x
        assert made["c.CV"] == count
        assert made["c.Q"] is (count >= 3)


def test_a_block_may_have_a_time_of_its_own_with_all_that_is_in_it() -> None:
    slow, fast = TimeBase(), TimeBase()
    text = """FUNCTION_BLOCK Inner VAR_OUTPUT done : BOOL; END_VAR VAR t : TON; END_VAR
    t(IN := TRUE, PT := T#1s); done := t.Q; END_FUNCTION_BLOCK
    PROGRAM Main VAR a, b : Inner; END_VAR a(); b(); END_PROGRAM"""
    made = Machine(text, time=slow, time_of={"b": fast})
    made.scan()
    fast.now_us = 1_000_000
    made.scan()
    assert (made["a.done"], made["b.done"]) == (False, True)
