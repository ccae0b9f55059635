"""Buttons at the line command the machine, through the PLC's counters and the real wire."""

import pytest

from cellctl.control.buttons import command_of
from cellctl.machine import Command, State
from drivers.plc_buttons import Button
from tests.whole_cell import whole_cell


@pytest.mark.parametrize(
    ("button", "state", "command"),
    [
        (Button.RESET, State.ABORTED, Command.CLEAR),
        (Button.RESET, State.STOPPED, Command.RESET),
        (Button.RESET, State.COMPLETE, Command.RESET),
        (Button.START, State.IDLE, Command.START),
        (Button.START, State.HELD, Command.UNHOLD),
        (Button.START, State.SUSPENDED, Command.UNSUSPEND),
        (Button.STOP, State.EXECUTE, Command.STOP),
        (Button.STOP, State.STOPPED, None),
        (Button.START, State.ABORTED, None),
        (Button.RESET, State.EXECUTE, None),
    ],
)
def test_a_press_means_what_the_state_allows(button: Button, state: State, command: Command | None) -> None:
    assert command_of(button, state) is command


async def test_an_operator_runs_the_cell_with_the_buttons_alone(tmp_path, learnt) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ask("recipe_use", name="x85")
        bench.press("reset")
        await bench.until(State.STOPPED)
        bench.press("reset")
        await bench.until(State.IDLE)
        bench.press("start")
        await bench.until(State.EXECUTE)
        bench.press("stop")
        await bench.until(State.STOPPED)
        assert any("stop button" in str(event) for event in bench.said("state"))
