"""The cyclic exchange with the PLC: connection, words out, picture in, one command at a time, waiting.

One task, `run`, owns the connection: it opens it, reads everything, reconciles, then exchanges all words once per scan.
Everybody else changes the words to be written and waits for what an exchange brings. After any error the connection is
closed and opened anew, so a late answer cannot meet a later question.
"""

import asyncio
import contextlib
import secrets
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

from drivers.errors import DeviceError, Garbled, LinkLost, Mismatch, NoAnswer, Refused
from drivers.modbus import ModbusLink
from drivers.plc_registers import (
    MAP_VERSION,
    READ_ADDRESS,
    READ_COUNT,
    RESULT_NAMES,
    WRITE_ADDRESS,
    WRITE_COUNT,
    CellWords,
    Command,
    Output,
    PlcImage,
    decode,
)

ANSWER_SHARE = 0.8  # an answer is waited for so long, in parts of the age at which a picture is stale
HEARTBEAT_WITHIN_S = 0.5
FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.1, 2.0
LONGEST_SCAN_S = 0.1  # the PLC takes a heartbeat that stands still for 500 ms as our end


@dataclass(eq=False)
class Order:
    """A command with its number. `done` gets the result; a done one that is still kept has nobody waiting for it."""

    number: int
    command: Command
    argument: int
    done: asyncio.Future[int]
    sent: bool = False

    def fail(self, error: DeviceError) -> None:
        """Tell the caller, if there still is one."""
        if not self.done.done():
            self.done.set_exception(error)
            self.done.exception()  # counts as seen, should the caller be cancelled in this turn of the loop


class PlcScan:
    """What goes round: `outputs`, `shown` and `taken` go out with each exchange, `picture` and `trouble` come back."""

    def __init__(
        self,
        device: str,
        host: str,
        port: int,
        *,
        unit_id: int,
        period_s: float,
        stale_after_s: float,
        one_request: bool,
    ) -> None:
        if not 0 < period_s <= LONGEST_SCAN_S:
            raise ValueError(f"scan_period_s must be above 0 and at most {LONGEST_SCAN_S} (got {period_s})")
        self.device = device
        self.count = 0  # exchanges and attempts to connect
        self.shown = CellWords()  # machine state and counts
        self.outputs = Output(0)
        self.taken = 0  # sequence of the last arrival that somebody got
        self.boot: int | None = None
        self._address = (host, port)
        self._unit_id = unit_id
        self._period_s = period_s
        self._stale_after_s = stale_after_s
        self._one_request = one_request
        self._session = secrets.randbelow(0xFFFF) + 1
        self._heartbeat = 0
        self._number = 0  # of the last command
        self._order: Order | None = None
        self._image: PlcImage | None = None
        self._image_at_s = self._beat_at_s = 0.0
        self._down: DeviceError | None = LinkLost(device, f"not connected yet to {host}:{port}")
        self._begun = self._carried = 0  # exchanges
        self._exchanged = asyncio.Event()
        self._kicked = False
        self._wake: asyncio.Future[None] | None = None

    # -- looking -------------------------------------------------------------------------------------------------

    @property
    def picture(self) -> PlcImage:
        """The newest picture; raises the trouble that makes it worthless."""
        trouble = self.trouble()
        if trouble is not None:
            raise trouble.with_traceback(None)
        assert self._image is not None
        return self._image

    @property
    def picture_age_s(self) -> float:
        """Since the request for the newest picture was sent."""
        return time.monotonic() - self._image_at_s

    def trouble(self) -> DeviceError | None:
        """What makes the newest picture worthless, None when nothing does."""
        if self._down is not None or self._image is None:
            return self._down
        if (age_s := self.picture_age_s) > self._stale_after_s:
            limit = f"limit {self._stale_after_s * 1000:.0f} ms"
            return NoAnswer(self.device, f"newest picture is {age_s * 1000:.0f} ms old ({limit}); is run() alive?")
        if (age_s := time.monotonic() - self._beat_at_s) > HEARTBEAT_WITHIN_S:
            beat = f"heartbeat (register 100) stands at {self._image.heartbeat} for {age_s * 1000:.0f} ms"
            return NoAnswer(self.device, f"{beat}; put the PLC into RUN")
        return self._unserved(self._image)

    def _unserved(self, image: PlcImage) -> DeviceError | None:
        if image.session == self._session:
            return None
        served = f"session served (register 102) is {image.session:#06x}, ours is {self._session:#06x}"
        if image.session == 0:
            return NoAnswer(self.device, f"{served}; look at the PLC program")
        return Mismatch(self.device, f"{served}; end the other client of the PLC and wait 1 s")

    # -- waiting -------------------------------------------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def within(self, within_s: float, late: Callable[[], str]) -> AsyncIterator[None]:
        """A deadline; when it passes, what is wrong with the link comes before what was not seen."""
        try:
            async with asyncio.timeout(within_s):
                yield
        except TimeoutError:
            trouble = self.trouble()
            if trouble is not None:
                raise trouble.with_traceback(None) from None
            raise NoAnswer(self.device, f"{late()} within {within_s:g} s") from None

    async def until(self, holds: Callable[[PlcImage], bool]) -> PlcImage:
        """Wait for a picture that is good and for which this holds; the caller has a deadline."""
        while self._image is None or self.trouble() is not None or not holds(self._image):
            await self._exchanged.wait()
        return self._image

    async def idle(self) -> PlcImage:
        """Wait until the PLC is well and has finished the command before; the caller has a deadline."""
        return await self.until(lambda image: self._order is None)

    async def carry(self) -> None:
        """Return after an exchange that wrote the words as they are now; the caller has a deadline."""
        wanted = self._begun + 1
        self._kick()
        while self._carried < wanted or self.trouble() is not None:
            await self._exchanged.wait()

    async def change(self) -> None:
        """Return when the exchange under way has ended, well or not: without trouble before the picture is stale."""
        await self._exchanged.wait()

    # -- commands --------------------------------------------------------------------------------------------------

    async def command(self, command: Command, argument: int = 0) -> None:
        """Have it executed exactly once; the caller has a deadline. Raises Refused, or NoAnswer when the PLC restarts.

        When the caller gives up, what was not sent yet never will be; what was sent finishes before the next command.
        """
        image = await self.idle()
        self._number = _after(self._number, image.accepted)
        order = Order(self._number, command, argument, asyncio.get_running_loop().create_future())
        self._order = order
        self._kick()
        result = await order.done
        if result:
            raise self._refusal(order, result)

    def end_command(self, why: str) -> None:
        """Make room for a command that ends the one under way; that one's caller gets Refused."""
        order, self._order = self._order, None
        if order is not None:
            order.fail(Refused(self.device, "ended", f"{_name(order)} was ended by {why}"))

    def _refusal(self, order: Order, result: int) -> Refused:
        name = RESULT_NAMES.get(result, "unknown result")
        state = "" if self._image is None else f", PLC state {self._image.state.words}, fault {self._image.fault}"
        return Refused(self.device, f"result {result}", f"{_name(order)}: {name} (register 109 is {result}{state})")

    def _settle(self, image: PlcImage) -> None:
        """Match the command under way with what the PLC says about it."""
        order = self._order
        if order is None:
            return
        if image.session != self._session:
            if order.done.done():
                self._order = None  # nobody waits for it: it must not run when we are served again
        elif order.sent and image.accepted == image.finished == order.number:
            self._order = None
            if not order.done.done():
                order.done.set_result(image.result)

    def _resume(self, order: Order, image: PlcImage) -> None:
        """The connection broke during a command: the PLC has its number, or gets it again, or it is given up."""
        known = image.accepted if self._image is None else self._image.accepted
        theirs, ours = (image.accepted - known) & 0xFFFF, (order.number - known) & 0xFFFF
        if theirs > ours:
            self._drop(f"PLC took commands of somebody else (register 107 is {image.accepted})")
        elif order.done.done() and image.accepted != order.number:
            self._order = None  # nobody waits for it: it must not run late

    def _drop(self, why: str) -> None:
        order, self._order = self._order, None
        if order is not None:
            order.fail(NoAnswer(self.device, f"{why} during {_name(order)}; it is not repeated, look at the cell"))

    # -- the exchange ------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Keep the exchange going, reconnecting for ever; ends only by cancellation."""
        back_off_s = FIRST_BACK_OFF_S
        try:
            while True:
                carried = self._carried
                await self._connection()
                worked = self._carried > carried
                back_off_s = FIRST_BACK_OFF_S if worked else min(2 * back_off_s, LONGEST_BACK_OFF_S)
                await asyncio.sleep(back_off_s)
        finally:
            self._lose(LinkLost(self.device, "the scan has ended; start run() again"))

    async def _connection(self) -> None:
        """One connection, until it fails."""
        host, port = self._address
        link = ModbusLink(self.device, host, port, unit_id=self._unit_id, within_s=ANSWER_SHARE * self._stale_after_s)
        try:
            await link.open()
            await self._reconcile(link)
            await self._go_round(link)
        except DeviceError as error:
            self._lose(error)
        finally:
            link.close()

    async def _reconcile(self, link: ModbusLink) -> None:
        """Read everything; only what still makes sense is written again."""
        own = await link.read(WRITE_ADDRESS, WRITE_COUNT)
        asked_at_s = time.monotonic()
        image = self._decoded(await link.read(READ_ADDRESS, READ_COUNT))
        if image.boot != self.boot:
            self._adopt(own, image)
        elif self._order is not None:
            self._resume(self._order, image)
        self._look_at(image, asked_at_s)
        self._down = None

    def _adopt(self, own: list[int], image: PlcImage) -> None:
        """First contact, or the PLC restarted: its counters are the truth."""
        if self.boot is None:  # an earlier cellctl may have left a battery at the cup: the vacuum must not drop
            self.outputs |= Output(own[6]) & Output.VACUUM
        self._drop(f"PLC restarted (boot counter in register 117 went from {self.boot} to {image.boot})")
        self.boot = image.boot
        self._number = image.accepted
        self.taken = own[7] if (image.arrival_seq - own[7]) & 0xFFFF <= 1 else image.arrival_seq

    async def _go_round(self, link: ModbusLink) -> None:
        """Exchange at a fixed rate, and at once when kicked."""
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            await self._exchange(link)
            if loop.time() >= due_s:
                due_s = max(due_s + self._period_s, loop.time())
            await self._pause(due_s)

    async def _exchange(self, link: ModbusLink) -> None:
        self._kicked = False
        self._begun += 1
        begun_at_s = time.monotonic()
        image = self._decoded(await self._transfer(link))
        if image.boot != self.boot:
            raise LinkLost(self.device, f"PLC restarted (boot counter {self.boot} -> {image.boot}, register 117)")
        self._look_at(image, begun_at_s)
        self._carried = self._begun
        self._announce()

    async def _transfer(self, link: ModbusLink) -> list[int]:
        """Words out, picture in; only the picture while another client is served, since its words are in our place."""
        if self._image is not None and self._image.session not in (0, self._session):
            return await link.read(READ_ADDRESS, READ_COUNT)
        words = self._words()
        if self._one_request:
            return await link.read_write(READ_ADDRESS, READ_COUNT, WRITE_ADDRESS, words)
        await link.write(WRITE_ADDRESS, words)
        return await link.read(READ_ADDRESS, READ_COUNT)

    def _words(self) -> list[int]:
        """Registers 0..15. A command is shown to the PLC only while it serves us."""
        assert self._image is not None
        self._heartbeat = (self._heartbeat + 1) & 0xFFFF
        if self._order is not None and self._order.done.done() and not self._order.sent:
            self._order = None  # given up before it was ever sent
        order = self._order if self._image.session == self._session else None
        if order is not None:
            order.sent = True
        return self.shown._replace(
            heartbeat=self._heartbeat,
            session=self._session,
            sequence=order.number if order else self._image.accepted,
            command=order.command if order else Command.NONE,
            argument=order.argument if order else 0,
            outputs=self.outputs,
            arrival_acknowledged=self.taken,
        ).encode()

    def _decoded(self, picture: list[int]) -> PlcImage:
        try:
            image = decode(picture)
        except ValueError as error:
            raise Garbled(self.device, f"{error}; load the PLC program of this cellctl") from None
        if image.map_version != MAP_VERSION:
            found = f"map version (register 101) is {image.map_version:#06x}, needed is {MAP_VERSION:#06x}"
            raise Mismatch(self.device, f"{found}; load the PLC program of this cellctl")
        return image

    def _look_at(self, image: PlcImage, at_s: float) -> None:
        if self._image is None or image.heartbeat != self._image.heartbeat or self._down is not None:
            self._beat_at_s = at_s
        self._image, self._image_at_s = image, at_s
        self._settle(image)

    def _lose(self, error: DeviceError) -> None:
        self._down = error
        self._announce()

    def _announce(self) -> None:
        """Wake everybody who waits for an exchange."""
        self.count += 1
        exchanged, self._exchanged = self._exchanged, asyncio.Event()
        exchanged.set()

    async def _pause(self, until_s: float) -> None:
        """Until that loop time, or until somebody kicks."""
        if self._kicked:
            return
        loop = asyncio.get_running_loop()
        self._wake = loop.create_future()
        timer = loop.call_at(until_s, self._stir)
        try:
            await self._wake
        finally:
            timer.cancel()
            self._wake = None

    def _stir(self) -> None:
        if self._wake is not None and not self._wake.done():
            self._wake.set_result(None)

    def _kick(self) -> None:
        """Have the next exchange now."""
        self._kicked = True
        self._stir()


def _name(order: Order) -> str:
    argument = f", argument {order.argument}" if order.argument else ""
    return f"{order.command.words} (command {int(order.command)}{argument}, sequence {order.number})"


def _after(number: int, accepted: int) -> int:
    """A command number that is new to the PLC and not 0, which a fresh PLC shows."""
    number = number % 0xFFFF + 1
    return number if number != accepted else number % 0xFFFF + 1
