"""The buttons at the PLC: their presses are counters, so none is lost between two exchanges and none is seen twice."""

from enum import Enum

from drivers.plc_registers import PlcImage


class Button(Enum):
    """A button that the PLC counts the presses of."""

    START = "start"
    STOP = "stop"
    RESET = "reset"


URGENCY = (Button.STOP, Button.RESET, Button.START)  # of presses that were counted in the same exchange


class Presses:
    """Which presses have been taken. Counters are one byte and wrap around."""

    def __init__(self) -> None:
        self._taken = dict.fromkeys(Button, 0)

    def drop(self, image: PlcImage) -> None:
        """Whatever was pressed until now was not meant for us, or is too old to be carried out."""
        self._taken = _counted(image)

    def waiting(self, image: PlcImage) -> Button | None:
        """A button that was pressed and not taken yet."""
        counted = _counted(image)
        return next((button for button in URGENCY if counted[button] != self._taken[button]), None)

    def take(self, button: Button) -> None:
        """One press of it."""
        self._taken[button] = (self._taken[button] + 1) & 0xFF


def _counted(image: PlcImage) -> dict[Button, int]:
    return {
        Button.START: image.start_presses,
        Button.STOP: image.stop_presses,
        Button.RESET: image.reset_presses,
    }
