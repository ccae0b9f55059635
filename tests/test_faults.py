"""Every exception has a row in the faults table, every row an exception, and every sentence says what to do."""

from collections.abc import Iterator

import pytest

from cellctl import faults
from cellctl.faults import FAULTS, CellError, Reaction, fault_for, sentence
from drivers.errors import DeviceError, NoAnswer, Refused


def family(root: type[Exception]) -> Iterator[type[Exception]]:
    for child in root.__subclasses__():
        yield child
        yield from family(child)


def test_every_exception_has_a_row_and_every_row_an_exception() -> None:
    assert {*family(CellError), *family(DeviceError)} == set(FAULTS)


def test_codes_are_unique() -> None:
    codes = [row.code for row in FAULTS.values()]
    assert len(codes) == len(set(codes))


@pytest.mark.parametrize("row", FAULTS.values(), ids=lambda row: row.code)
def test_every_row_tells_the_operator_what_to_do(row: faults.Fault) -> None:
    assert row.remedy.endswith(".")
    assert len(row.remedy) > 20


def test_the_sentence_holds_evidence_and_remedy() -> None:
    text = sentence(Refused("robot", "6.301", "servo off at MOVE"))
    assert text.startswith("[D4] robot: servo off at MOVE (code 6.301). ")
    assert text.endswith(FAULTS[Refused].remedy)


def test_an_unknown_error_aborts() -> None:
    assert fault_for(ZeroDivisionError()).reaction is Reaction.ABORT
    assert sentence(ZeroDivisionError("by zero")).startswith("[X1] ZeroDivisionError: by zero.")


def test_a_silent_device_aborts() -> None:
    assert fault_for(NoAnswer("plc", "nothing for 250 ms")).code == "D2"
