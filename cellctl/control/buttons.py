"""The buttons at the line, as the PLC counts them: what a press means in each state."""

from collections.abc import Callable
from typing import NoReturn

from cellctl.cell import Cell
from cellctl.control.errors import Declined
from cellctl.log import log
from cellctl.machine import Command, NotAllowed, State, commands_allowed
from drivers.plc_buttons import Button

MEANS = {  # the first of these that the state allows
    Button.START: (Command.START, Command.UNHOLD, Command.UNSUSPEND),
    Button.STOP: (Command.STOP,),
    Button.RESET: (Command.CLEAR, Command.RESET),
}


def command_of(button: Button, state: State) -> Command | None:
    """None: nothing is to be done in this state."""
    return next((command for command in MEANS[button] if command in commands_allowed(state)), None)


async def watch_buttons(cell: Cell, act: Callable[[Command, str], None]) -> NoReturn:
    """Carry out each press, for ever; one that means nothing is logged."""
    while True:
        button = await cell.devices.plc.pressed()
        command = command_of(button, cell.state)
        if command is None:
            log.info(f"{button.value} button: not in {cell.state.title}")
            continue
        try:
            act(command, f"{button.value} button")
        except (Declined, NotAllowed) as error:
            log.warning(f"{button.value} button: {error}")
