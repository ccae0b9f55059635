"""What the Structured Text interpreter refuses, with the place and a sentence; and that nothing else ever comes out."""

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.st.errors import StError
from simulators.st.library import TimeBase
from simulators.st.machine import Machine
from simulators.st.tokens import KEYWORDS, NOT_SUPPORTED
from tests.st_programs import machine, program

CELL = Path("deploy/plc/cell.st").read_text()
VARIABLES = "VAR a, b : INT; w : WORD; on1 : BOOL; d : TIME; t : TON; END_VAR VAR CONSTANT k : INT := 5; END_VAR"


@pytest.mark.parametrize(
    ("statement", "column", "said"),
    [
        ("a := b + w;", 8, "+ needs two values of one type (got INT and WORD)"),
        ("a := w;", 6, "a is INT (got WORD); convert it with WORD_TO_INT"),
        ("a := 40000;", 6, "40000 does not fit into INT"),
        ("a := UINT#-1;", 6, "-1 does not fit into UINT"),
        ("on1 := a;", 8, "on1 is BOOL (got INT); convert it with INT_TO_BOOL"),
        ("on1 := 1;", 8, "on1 is BOOL (got integer literal)"),
        ("d := 500;", 6, "d is TIME (got integer literal)"),
        ("w := w + w;", 8, "+ does not go with WORD"),
        ("on1 := w < w;", 10, "< does not go with WORD"),
        ("on1 := d * d = d;", 10, "* does not go with TIME"),
        ("a := NOT a;", 6, "NOT does not go with INT"),
        ("w := -w;", 6, "- does not go with WORD"),
        ("IF a THEN b := 1; END_IF;", 4, "a condition is BOOL (got INT); convert it with INT_TO_BOOL"),
        ("c := 1;", 1, "c is not declared"),
        ("k := 1;", 1, "k cannot be assigned: it is a CONSTANT"),
        ("t := 1;", 1, "t cannot be assigned: only its own call changes a function block"),
        ("t.Q := TRUE;", 1, "t.Q cannot be assigned: only its own call changes a function block"),
        ("on1 := t.IN;", 8, "IN is no output of TON"),
        ("on1 := t;", 8, "t is a function block; name one of its outputs"),
        ("on1 := a.Q;", 8, "a is no function block, so it has no Q"),
        ("a();", 1, "a is no function block, so it cannot be called as a statement"),
        ("t(TRUE);", 3, "inputs of TON are IN, PT, given by name"),
        ("t(Q := TRUE);", 3, "inputs of TON are IN, PT, given by name"),
        ("t(ET => a);", 9, "ET of TON is TIME (got INT)"),
        ("t(IN := TRUE, in := TRUE);", 15, "given twice"),
        ("a := ABS(a);", 6, "there is no function ABS (functions are declared before their use)"),
        ("a := WORD_TO_INT();", 6, "WORD_TO_INT takes one value without a name"),
        ("a := WORD_TO_INT(IN := w);", 6, "WORD_TO_INT takes one value without a name"),
        ("a := t.Q(1);", 6, "t.Q is no function"),
        ("CASE w OF 1: ; END_CASE;", 6, "CASE goes by a whole number (got WORD)"),
        ("CASE a OF 1: ; 2, 1: ; END_CASE;", 19, "label 1 stands twice"),
        ("CASE a OF 70000: ; END_CASE;", 11, "label 70000 does not fit into INT"),
        ("CASE a OF b: ; END_CASE;", 11, "a number as label of CASE is needed here (got b)"),
        ("a := 1 b := 2;", 8, "; after the statement is needed here (got b)"),
        ("a = 1;", 3, ":= after a is needed here (got =)"),
        ("a := (1;", 8, ") to close the parenthesis is needed here (got ;)"),
        ("a := 1.5;", 6, "1.5 is no whole number (REAL is not supported)"),
        ("a := 3#12;", 6, "3#12: there is no type 3; bases are 2, 8 and 16"),
        ("a := 16#GG;", 6, "16#GG is no number to base 16"),
        ("d := T#5;", 6, "T#5: a duration is written T#1h2m3s500ms"),
        ("d := T#30d;", 6, "T#30d: a TIME has 32 bits of ms, less than 25 days"),
        ("d := T#1.5h3s;", 6, "T#1.5h3s: only the last part may have decimals"),
        ("FOR a := 1 TO 3 DO b := a; END_FOR;", 1, "FOR is a keyword that is not supported"),
        ("RETURN;", 1, "RETURN is a keyword that is not supported"),
        ("w := %MW3;", 6, "%MW3 is used directly; declare a variable AT %MW3"),
        ("a := 1; // done", 9, "comments are written (* like this *)"),
        ("a := 1; (* done", 9, "comment is never closed with *)"),
        ("a := 'x';", 6, "strings are not supported"),
        ("{pragma}", 1, "pragmas are not portable"),
        ("bad__name := 1;", 1, "bad__name: underscores that are doubled or last are not portable"),
        ("a := ä;", 6, "'ä' has no meaning here"),
        ("a := 7 / 0;", 8, "division by zero"),
        ("a := 5 ** 2;", 8, "; after the statement is needed here (got **)"),
    ],
)
def test_a_wrong_statement_is_refused_with_its_place(statement: str, column: int, said: str) -> None:
    with pytest.raises(StError) as caught:
        machine(statement, VARIABLES)
    assert str(caught.value) == f"program:4:{column}: {said}"


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ("VAR a : INT; A : UINT; END_VAR", "3:14: A is declared twice"),
        ("VAR ton : INT; END_VAR", "3:5: ton is the name of something else"),
        ("VAR a : REAL; END_VAR", "3:9: REAL is a keyword that is not supported"),
        ("VAR a : Motor; END_VAR", "3:9: there is no type Motor (types stand before their use)"),
        ("VAR a : UINT := -1; END_VAR", "3:17: a is UINT, which this value is not"),
        ("VAR a : BOOL := 0; END_VAR", "3:17: a is BOOL, which this value is not"),
        ("VAR a AT %IX0.0 : BOOL; b : BOOL; END_VAR", "3:25: variables with an address need a VAR block of their own"),
        ("VAR a AT %IX0.8 : BOOL; END_VAR", "3:10: an address is written %IX0.0, %QX0.0, %IW0 or %MW0 (got %IX0.8)"),
        ("VAR a AT %MW07 : INT; END_VAR", "3:10: an address is written %IX0.0, %QX0.0, %IW0 or %MW0 (got %MW07)"),
        ("VAR a AT %MW0 : BOOL; END_VAR", "3:5: a: BOOL does not fit to %MW0"),
        ("VAR a AT %MD0 : TIME; END_VAR", "3:5: a: TIME does not fit to %MD0"),
        ("VAR a AT %MW0 : INT; b AT %MW0 : INT; END_VAR", "3:22: b: %MW0 is a already"),
        ("VAR a, b AT %MW0 : INT; END_VAR", "3:8: two variables at %MW0"),
        ("VAR CONSTANT a : INT; END_VAR", "3:14: a: a CONSTANT needs a value"),
        ("VAR CONSTANT a AT %MW0 : INT := 1; END_VAR", "3:14: a: a CONSTANT has no address"),
        ("VAR RETAIN t : TON; END_VAR", "3:12: t: a function block has no value, no address, and is not RETAIN"),
        ("VAR_INPUT a : INT; END_VAR", "3:11: a: a PROGRAM has neither inputs nor outputs"),
        ("VAR_GLOBAL a : INT; END_VAR", "3:1: VAR_GLOBAL is a keyword that is not supported"),
        ("VAR a : INT END_VAR", "3:13: ; after the declaration is needed here (got END_VAR)"),
    ],
)
def test_a_wrong_declaration_is_refused_with_its_place(variables: str, said: str) -> None:
    with pytest.raises(StError) as caught:
        machine(";", variables)
    assert str(caught.value) == f"program:{said}"


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("", "1:1: exactly one PROGRAM is needed (got 0)"),
        (program(";") + program(";"), "7:9: Main is the name of something else"),
        ("VAR a : INT; END_VAR", "1:1: FUNCTION, FUNCTION_BLOCK or PROGRAM is needed here (got VAR)"),
        ("PROGRAM Main a := 1;", "1:21: END_PROGRAM to end Main is needed here (got the end of the file)"),
        ("FUNCTION F : INT VAR t : TON; END_VAR END_FUNCTION", "1:22: t: a FUNCTION keeps nothing"),
        ("FUNCTION F : INT VAR_OUTPUT x : INT; END_VAR END_FUNCTION", "1:29: x: a FUNCTION has no outputs but its"),
        ("FUNCTION_BLOCK B VAR RETAIN x : INT; END_VAR END_FUNCTION_BLOCK", "1:29: x: only a PROGRAM has RETAIN"),
        ("FUNCTION F : TON END_FUNCTION", "1:10: there is no type TON"),
        ("FUNCTION F : INT F := F(); END_FUNCTION", "1:23: there is no function F"),
        ("FUNCTION_BLOCK B VAR x : B; END_VAR END_FUNCTION_BLOCK", "1:26: there is no type B"),
        ("FUNCTION_BLOCK B VAR x AT %MW0 : INT; END_VAR END_FUNCTION_BLOCK", "1:22: x: only a PROGRAM has addresses"),
        ("FUNCTION_BLOCK B VAR_INPUT x : INT; END_VAR x := 1; END_FUNCTION_BLOCK", "1:45: x cannot be assigned"),
    ],
)
def test_a_wrong_unit_is_refused_with_its_place(source: str, said: str) -> None:
    with pytest.raises(StError) as caught:
        Machine(source, time=TimeBase(), name="cell.st")
    assert str(caught.value).startswith(f"cell.st:{said}")


def test_an_input_terminal_cannot_be_driven() -> None:
    with pytest.raises(StError, match=r"button cannot be assigned: it is the input %IX0\.0"):
        machine("button := TRUE;", "VAR button AT %IX0.0 : BOOL; END_VAR")


@pytest.mark.parametrize("text", ["(" * 3_000, "NOT " * 3_000, "-" * 3_000, "1+" * 3_000, "IF TRUE THEN " * 3_000])
def test_nesting_without_end_is_refused(text: str) -> None:
    with pytest.raises(StError, match=r"nested deeper than|more than 80 operators"):
        machine(text if text.startswith("IF") else f"a := {text}1;", VARIABLES)


def test_what_cannot_have_a_time_of_its_own_is_refused() -> None:
    with pytest.raises(StError, match="there is no function block nobody, a in the PROGRAM"):
        Machine(program(";", VARIABLES), time=TimeBase(), time_of={"nobody": TimeBase(), "a": TimeBase()})


# -- whatever comes in ---------------------------------------------------------------------------------------------

WORDS = [*sorted(KEYWORDS), *sorted(NOT_SUPPORTED)[::7], "a", "b", "w", "on1", "t", "k", "Q", "IN", "PT", "INT", "TON"]
SIGNS = [":=", "=>", "=", "<>", "<", ">=", "+", "-", "*", "/", "(", ")", ",", ";", ":", ".", "..", "**", "&", "%MW0"]
LITERALS = ["0", "7", "70000", "16#FF", "T#5s", "T#", "TRUE", "1.5", "WORD#16#1", "(*", "*)", "'", "\n", "ä", "#"]
soups = st.lists(st.sampled_from(WORDS + SIGNS + LITERALS), max_size=40).map(" ".join)


def refusal(source: str) -> StError | None:
    """Compile and run it; nothing but an StError may come out."""
    try:
        made = Machine(source, time=TimeBase())
        for _ in range(3):
            made.scan()
    except StError as error:
        return error
    return None


def try_to_run(source: str) -> None:
    """It runs, or is refused with a place inside its text."""
    error, lines = refusal(source), source.split("\n")
    if error is not None:
        assert 1 <= error.spot.line <= len(lines)
        assert 1 <= error.spot.column <= len(lines[error.spot.line - 1]) + 1
        assert re.fullmatch(r"program:\d+:\d+: \S.*", str(error), re.DOTALL)


@settings(max_examples=150, deadline=None)
@given(soups)
def test_a_soup_of_tokens_is_refused_or_runs(soup: str) -> None:
    try_to_run(program(soup, VARIABLES))
    try_to_run(soup)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=80))
def test_any_text_is_refused_or_runs(text: str) -> None:
    try_to_run(text.replace("\r", ""))
    try_to_run(program(f"a := {text};", VARIABLES))


PIECES = re.findall(
    r"\w+|\s+|[^\w\s]+", CELL[CELL.index("FUNCTION_BLOCK ConveyorSequence") : CELL.index("PROGRAM Cell")]
)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_the_delivered_program_with_pieces_lost_doubled_or_swapped_is_refused_or_runs(data: st.DataObject) -> None:
    pieces = list(PIECES)
    for _ in range(data.draw(st.integers(1, 3))):
        at, other = (data.draw(st.integers(0, len(pieces) - 1)) for _ in range(2))
        how = data.draw(st.sampled_from(["lose", "double", "swap", "copy"]))
        if how == "swap":
            pieces[at], pieces[other] = pieces[other], pieces[at]
        elif how == "copy":
            pieces[at] = pieces[other]
        else:
            pieces[at] = "" if how == "lose" else pieces[at] * 2
    try_to_run(f"{''.join(pieces)}\nPROGRAM Main VAR c : ConveyorSequence; END_VAR c(start := TRUE); END_PROGRAM")
