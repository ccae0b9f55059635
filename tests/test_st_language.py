"""The Structured Text interpreter does what IEC 61131-3 says: values, operators, statements, functions and blocks."""

import ctypes

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.st.errors import StFault
from simulators.st.library import TimeBase
from simulators.st.machine import Machine
from tests.st_programs import evaluated, machine, program

C_TYPES = {
    "SINT": ctypes.c_int8,
    "INT": ctypes.c_int16,
    "DINT": ctypes.c_int32,
    "USINT": ctypes.c_uint8,
    "UINT": ctypes.c_uint16,
    "UDINT": ctypes.c_uint32,
    "BYTE": ctypes.c_uint8,
    "WORD": ctypes.c_uint16,
    "DWORD": ctypes.c_uint32,
}
NUMBERS = ("SINT", "INT", "DINT", "USINT", "UINT", "UDINT")
BITS = ("BYTE", "WORD", "DWORD")


def in_c(kind: str, value: int) -> int:
    """What a C program of that width would keep."""
    return int(C_TYPES[kind](value).value)


@st.composite
def pairs(draw: st.DrawFn, kinds: tuple[str, ...]) -> tuple[str, int, int]:
    kind = draw(st.sampled_from(kinds))
    numbers = st.integers(-(2**32), 2**32) | st.integers(-4, 4)
    return kind, in_c(kind, draw(numbers)), in_c(kind, draw(numbers))


def two(kind: str) -> str:
    return f"VAR a, b, result : {kind}; holds : BOOL; END_VAR"


@settings(max_examples=50, deadline=None)
@given(pairs(NUMBERS), st.sampled_from("+-*"))
def test_arithmetic_keeps_the_bits_of_its_type_as_c_does(pair: tuple[str, int, int], sign: str) -> None:
    kind, a, b = pair
    made = machine(f"result := a {sign} b;", two(kind))
    made["a"], made["b"] = a, b
    made.scan()
    assert made["result"] == in_c(kind, {"+": a + b, "-": a - b, "*": a * b}[sign])


@settings(max_examples=50, deadline=None)
@given(pairs(NUMBERS))
def test_division_goes_towards_zero_and_mod_has_the_sign_of_the_dividend(pair: tuple[str, int, int]) -> None:
    kind, a, b = pair
    made = machine("result := a / b; rest := a MOD b;", f"VAR a, b, result, rest : {kind}; END_VAR")
    made["a"], made["b"] = a, b
    if b == 0:
        with pytest.raises(StFault, match="division by zero"):
            made.scan()
        return
    made.scan()
    whole, rest = made["result"], made["rest"]
    assert in_c(kind, int(whole) * b + int(rest)) == a
    assert abs(rest) < abs(b)
    assert rest == 0 or (rest < 0) == (a < 0)


@settings(max_examples=50, deadline=None)
@given(pairs(BITS), st.sampled_from(["AND", "OR", "XOR", "&"]))
def test_bit_strings_are_combined_bit_by_bit(pair: tuple[str, int, int], sign: str) -> None:
    kind, a, b = pair
    made = machine(f"result := a {sign} NOT b;", two(kind))
    made["a"], made["b"] = a, b
    made.scan()
    complement = in_c(kind, ~b)
    assert (
        made["result"]
        == {"AND": a & complement, "&": a & complement, "OR": a | complement, "XOR": a ^ complement}[sign]
    )


@settings(max_examples=50, deadline=None)
@given(pairs(NUMBERS), st.sampled_from(["=", "<>", "<", ">", "<=", ">="]))
def test_comparisons_order_numbers(pair: tuple[str, int, int], sign: str) -> None:
    kind, a, b = pair
    made = machine(f"holds := a {sign} b;", two(kind))
    made["a"], made["b"] = a, b
    made.scan()
    assert made["holds"] is {"=": a == b, "<>": a != b, "<": a < b, ">": a > b, "<=": a <= b, ">=": a >= b}[sign]


@settings(max_examples=50, deadline=None)
@given(pairs(NUMBERS + BITS), st.sampled_from(NUMBERS + BITS))
def test_conversions_keep_the_low_bits(pair: tuple[str, int, int], target: str) -> None:
    kind, value, _ = pair
    if kind == target:
        return
    made = machine(f"result := {kind}_TO_{target}(given);", f"VAR given : {kind}; result : {target}; END_VAR")
    made["given"] = value
    made.scan()
    assert made["result"] == in_c(target, value)


@pytest.mark.parametrize(
    ("expression", "kind", "value"),
    [
        ("2 + 3 * 4", "INT", 14),
        ("(2 + 3) * 4", "INT", 20),
        ("-2 - 3 - 4", "INT", -9),
        ("100 / 7 MOD 4", "INT", 2),
        ("16#FF", "UINT", 255),
        ("2#1010_0101", "BYTE", 0xA5),
        ("8#17", "INT", 15),
        ("UINT#16#FFFF", "UINT", 65535),
        ("INT#-5", "INT", -5),
        ("1_000", "INT", 1000),
        ("TRUE OR FALSE AND FALSE", "BOOL", True),
        ("NOT TRUE OR TRUE", "BOOL", True),
        ("TRUE XOR TRUE AND FALSE", "BOOL", True),
        ("1 < 2 = TRUE", "BOOL", True),
        ("BOOL#1", "BOOL", True),
        ("BOOL_TO_INT(TRUE) + 1", "INT", 2),
        ("INT_TO_BOOL(7)", "BOOL", True),
        ("T#1h2m3s4ms", "TIME", 3_723_004_000),
        ("T#1.5s", "TIME", 1_500_000),
        ("TIME#-250ms", "TIME", -250_000),
        ("T#1d_2h", "TIME", 93_600_000_000),
        ("T#1s + T#500ms - T#200ms", "TIME", 1_300_000),
        ("TIME_TO_UDINT(T#1.2345s)", "UDINT", 1234),
        ("UINT_TO_TIME(250)", "TIME", 250_000),
    ],
)
def test_expressions_have_the_value_that_the_standard_gives_them(expression: str, kind: str, value: int | bool) -> None:
    found = evaluated(expression, kind)
    assert found == value
    assert type(found) is type(value)


def test_names_and_keywords_are_read_without_regard_to_case() -> None:
    made = machine("if Wanted THEN COUNT := Count + 1; end_if;", "var wanted : bool := true; Count : Uint; END_VAR")
    made.scan()
    assert made["COUNT"] == 1


@pytest.mark.parametrize(("level", "chosen"), [(-1, 1), (0, 2), (5, 3), (6, 3), (7, 4), (30_000, 4)])
def test_if_takes_the_first_branch_that_holds_and_case_the_label(level: int, chosen: int) -> None:
    made = machine(
        """IF level < 0 THEN byIf := 1; ELSIF level = 0 THEN byIf := 2;
        ELSIF level <= 6 AND level >= 5 THEN byIf := 3; ELSE byIf := 4; END_IF;
        CASE level OF -1: byCase := 1; 0: byCase := 2; 5, 6: byCase := 3; ELSE byCase := 4; END_CASE;""",
        "VAR level, byIf, byCase : INT; END_VAR",
    )
    made["level"] = level
    made.scan()
    assert (made["byIf"], made["byCase"]) == (chosen, chosen)


def test_a_case_without_else_does_nothing_for_other_values() -> None:
    made = machine("CASE level OF 1: hit := TRUE; END_CASE;", "VAR level : UINT; hit : BOOL; END_VAR")
    made.scan()
    assert made["hit"] is False


COUNTER = """
FUNCTION_BLOCK Counter
VAR_INPUT width : INT := 1; END_VAR
VAR_OUTPUT total : INT; END_VAR
VAR calls : UINT; END_VAR
calls := calls + 1;
total := total + width;
END_FUNCTION_BLOCK
FUNCTION_BLOCK TwoCounters
VAR_OUTPUT sum : INT; END_VAR
VAR first, second : Counter; END_VAR
first(width := 2);
second();
sum := first.total + second.total;
END_FUNCTION_BLOCK
"""


def test_function_blocks_keep_their_memory_and_inputs_that_are_not_given_stay() -> None:
    made = machine(
        "IF NOT begun THEN a(width := 5); begun := TRUE; ELSE a(); END_IF; both(sum => seen);",
        "VAR a : Counter; both : TwoCounters; begun : BOOL; seen : INT; END_VAR",
        COUNTER,
    )
    for _ in range(3):
        made.scan()
    assert (made["a.total"], made["a.calls"]) == (15, 3)
    assert (made["both.first.total"], made["both.second.total"], made["seen"]) == (6, 3, 9)


def test_functions_keep_nothing_from_one_call_to_the_next() -> None:
    made = machine(
        "result := Sum(a := 2, b := Sum(b := 3, a := 4));",
        "VAR result : INT; END_VAR",
        """FUNCTION Sum : INT
        VAR_INPUT a, b : INT; END_VAR
        VAR kept : INT; END_VAR
        kept := kept + a + b;
        Sum := Sum + kept;
        END_FUNCTION""",
    )
    for _ in range(2):
        made.scan()
        assert made["result"] == 9


def test_a_power_cycle_forgets_all_but_what_is_retained() -> None:
    made = machine(
        "count := count + 1; kept := kept + 1; inner();",
        "VAR count : UINT := 5; inner : Counter; END_VAR VAR RETAIN kept : UINT; END_VAR",
        COUNTER,
    )
    for _ in range(3):
        made.scan()
    memory = made.memory
    made.power_cycle()
    assert (made["count"], made["kept"], made["inner.total"]) == (5, 3, 0)
    made.scan()
    assert (made["count"], made["kept"], made["inner.total"]) == (6, 4, 1)
    assert made.memory is memory


def test_two_machines_of_one_source_share_nothing() -> None:
    text = program("count := count + 1;", "VAR count : UINT; END_VAR")
    first, second = (Machine(text, time=TimeBase()) for _ in range(2))
    first.scan()
    assert (first["count"], second["count"]) == (1, 0)


def test_located_variables_are_found_by_their_addresses() -> None:
    made = machine(
        "letter := 16#1234; motor := button;",
        "VAR button AT %IX0.7 : BOOL; motor AT %qx1.0 : BOOL; letter AT %MW3 : WORD; END_VAR",
    )
    made.memory[made.located("%I")["%IX0.7"]] = True
    made.scan()
    assert made.memory[made.located("%Q")["%QX1.0"]] is True
    assert made.memory[made.located("%MW")["%MW3"]] == 0x1234


def test_the_online_view_refuses_what_does_not_exist_or_fit() -> None:
    made = machine(";", "VAR count : UINT; inner : Counter; END_VAR", COUNTER)
    for path in ("nothing", "inner", "inner.nothing", "count.x", ""):
        with pytest.raises(KeyError, match="has no"):
            _ = made[path]
    for value in (-1, 65536):
        with pytest.raises(ValueError, match="count is UINT"):
            made["count"] = value


def test_a_fault_at_run_time_names_its_place() -> None:
    made = machine("result :=\n  10 / divisor;", "VAR result, divisor : INT; END_VAR")
    with pytest.raises(StFault) as caught:
        made.scan()
    assert str(caught.value) == "program:5:6: division by zero"
