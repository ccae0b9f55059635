"""Commands to the PLC, each executed exactly once or not at all, whatever becomes of the connection. No I/O.

A command has a number and is shown to the PLC until the PLC names that number as accepted and finished. After a broken
connection the PLC's own numbers say whether it was seen.
"""

import asyncio
from dataclasses import dataclass

from drivers.errors import DeviceError, NoAnswer, Refused
from drivers.plc_registers import RESULT_NAMES, Command, PlcImage


@dataclass(eq=False)
class Order:
    """A command with its number. `done` gets the result; a done one that is still kept has nobody waiting for it."""

    number: int
    command: Command
    argument: int
    done: asyncio.Future[PlcImage]
    sent: bool = False

    def fail(self, error: DeviceError) -> None:
        """Tell the caller, if there still is one."""
        if not self.done.done():
            self.done.set_exception(error)
            self.done.exception()  # counts as seen, should the caller be cancelled in this turn of the loop

    def __str__(self) -> str:
        argument = f", argument {self.argument}" if self.argument else ""
        return f"{self.command.words} (command {int(self.command)}{argument}, sequence {self.number})"


class Orders:
    """One command at a time."""

    def __init__(self, device: str) -> None:
        self.under_way: Order | None = None
        self._device = device
        self._number = 0  # of the last command

    def give(self, command: Command, argument: int, accepted: int) -> Order:
        """A command with a number that the PLC has not seen."""
        assert self.under_way is None
        self._number = _after(self._number, accepted)
        done: asyncio.Future[PlcImage] = asyncio.get_running_loop().create_future()
        self.under_way = Order(self._number, command, argument, done)
        return self.under_way

    def refusal(self, order: Order, image: PlcImage) -> Refused:
        """What the PLC said instead of yes."""
        name = RESULT_NAMES.get(image.result, "unknown result")
        state = f"PLC state {image.state.words}, fault {image.fault}"
        said = f"{order}: {name} (register 109 is {image.result}, {state})"
        return Refused(self._device, f"result {image.result}", said)

    def end(self, why: str) -> None:
        """Make room for a command that ends the one under way; that one's caller gets Refused."""
        order, self.under_way = self.under_way, None
        if order is not None:
            order.fail(Refused(self._device, "ended", f"{order} was ended by {why}"))

    def drop(self, why: str) -> None:
        """What became of the command under way cannot be known: it is never repeated."""
        order, self.under_way = self.under_way, None
        if order is not None:
            order.fail(NoAnswer(self._device, f"{why} during {order}; it is not repeated, look at the cell"))

    def shown(self, image: PlcImage, ours: bool) -> tuple[int, int, int]:
        """Registers 3, 4 and 5 to write. A command is shown to the PLC only while it serves us."""
        order = self.under_way
        if order is not None and order.done.done() and not order.sent:
            order = self.under_way = None  # given up before it was ever sent
        if order is None or not ours:
            return image.accepted, Command.NONE, 0
        order.sent = True
        return order.number, order.command, order.argument

    def settle(self, image: PlcImage, ours: bool) -> None:
        """Match the command under way with what the PLC says about it."""
        order = self.under_way
        if order is None:
            return
        if not ours:
            if order.done.done():
                self.under_way = None  # nobody waits for it: it must not run when we are served again
        elif order.sent and image.accepted == image.finished == order.number:
            self.under_way = None
            if not order.done.done():
                order.done.set_result(image)

    def resume(self, known: int, image: PlcImage) -> None:
        """The connection broke: the PLC has the number, or gets it again, or the command is given up.

        `known` is the number that the PLC had accepted when it was last seen.
        """
        order = self.under_way
        if order is None:
            return
        theirs, ours = (image.accepted - known) & 0xFFFF, (order.number - known) & 0xFFFF
        if theirs > ours:
            self.drop(f"PLC took commands of somebody else (register 107 is {image.accepted})")
        elif order.done.done() and image.accepted != order.number:
            self.under_way = None  # nobody waits for it: it must not run late

    def restart(self, accepted: int, why: str) -> None:
        """First contact, or the PLC restarted: its numbers are the truth."""
        self.drop(why)
        self._number = accepted


def _after(number: int, accepted: int) -> int:
    """A command number that is new to the PLC and not 0, which a fresh PLC shows."""
    number = number % 0xFFFF + 1
    return number if number != accepted else number % 0xFFFF + 1
