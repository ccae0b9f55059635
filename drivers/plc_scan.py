"""The cyclic exchange with the PLC: connection, words out, picture in, waiting for what an exchange brings.

One task, `run`, owns the connection: it opens it, reads everything, reconciles, then exchanges all words once per scan.
Everybody else changes the words to be written and waits. After any error the connection is closed and opened anew, so a
late answer cannot meet a later question.
"""

import asyncio
import contextlib
import secrets
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence

from drivers.errors import DeviceError, LinkLost, NoAnswer
from drivers.plc_ages import Ages
from drivers.plc_buttons import Button, Presses
from drivers.plc_cycle import PlcCycle
from drivers.plc_layout import PlcAddress
from drivers.plc_orders import Orders
from drivers.plc_picture import DEVICE, PlcPicture, read_picture
from drivers.plc_port import PlcPort
from drivers.plc_registers import WRITE_COUNT, CellWords, Command, Output, PlcImage
from drivers.plc_tags import Packet, Seen

ANSWER_SHARE = 0.8  # an answer is waited for so long, in parts of the age at which a picture is stale
FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.1, 2.0
STEADY_S = 1.0  # a connection that has worked for so long is tried anew once before its failure is told
LONGEST_SCAN_S = 0.1  # the PLC takes a heartbeat that stands still for 500 ms as our end
PACKETS_KEPT = 400  # the last two seconds of a 10 ms scan

Condition = Callable[[], bool]


class PlcScan:
    """What goes round: `outputs`, `shown` and `taken` go out with each exchange, `picture` and `trouble` come back."""

    def __init__(self, address: PlcAddress, *, period_s: float, stale_after_s: float) -> None:
        if not 0 < period_s <= LONGEST_SCAN_S:
            raise ValueError(f"scan_period_s must be above 0 and at most {LONGEST_SCAN_S} (got {period_s})")
        self.count = 0  # exchanges and attempts to connect
        self.shown = CellWords()  # machine state and counts
        self.outputs = Output(0)
        self.taken = 0  # sequence of the last arrival that somebody got
        self.boot: int | None = None
        self._address = address
        self._period_s = period_s
        self._stale_after_s = stale_after_s
        self._session = secrets.randbelow(0xFFFF) + 1
        self._transaction = secrets.randbelow(0x10000)
        self._orders = Orders(DEVICE)
        self._presses = Presses()
        down = LinkLost(DEVICE, f"not connected yet to {address.host}:{address.port}")
        self._picture = PlcPicture(self._session, stale_after_s, down)
        self._written = Ages(WRITE_COUNT)
        self._packets: deque[tuple[float, bool, bytes]] = deque(maxlen=PACKETS_KEPT)
        self._cycle: PlcCycle | None = None
        self._losing: asyncio.TimerHandle | None = None
        self._heartbeat = 0
        self._begun = self._carried = 0  # exchanges
        self._waiters: list[tuple[Condition, asyncio.Future[None]]] = []

    # -- looking -------------------------------------------------------------------------------------------------

    @property
    def picture(self) -> PlcImage:
        """The newest picture; raises the trouble that makes it worthless."""
        return self._picture.good

    @property
    def picture_age_s(self) -> float:
        """Since the request for the newest picture was sent."""
        return self._picture.age_s

    def trouble(self) -> DeviceError | None:
        """What makes the newest picture worthless, None when nothing does."""
        return self._picture.trouble()

    def seen(self) -> Seen:
        """All registers as they went over the wire last, with their ages, and the newest packets."""
        trouble, packets = self.trouble(), tuple(map(Packet._make, self._packets))
        return Seen(time.monotonic(), self._written, self._picture.ages, packets, trouble.detail if trouble else "")

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
            raise NoAnswer(DEVICE, f"{late()} within {within_s:g} s") from None

    async def wait(self, condition: Condition) -> None:
        """Wait until this holds after an exchange, well or not, or holds already.

        It is looked at when an exchange ends, so nobody is woken for nothing a hundred times a second.
        """
        while not condition():
            waiter = (condition, asyncio.get_running_loop().create_future())
            self._waiters.append(waiter)
            try:
                await waiter[1]
            finally:
                self._waiters.remove(waiter)

    async def until(self, holds: Callable[[PlcImage], bool]) -> PlcImage:
        """Wait for a picture that is good and for which this holds; the caller has a deadline."""
        picture = self._picture
        await self.wait(lambda: picture.image is not None and picture.trouble() is None and holds(picture.image))
        assert picture.image is not None
        return picture.image

    async def idle(self) -> PlcImage:
        """Wait until the PLC is well and has finished the command before; the caller has a deadline."""
        return await self.until(lambda image: self._orders.under_way is None)

    async def carry(self) -> None:
        """Return after an exchange that wrote the words as they are now; the caller has a deadline."""
        wanted = self._begun + 1
        self._kick()
        await self.wait(lambda: self._carried >= wanted and self.trouble() is None)

    async def pressed(self) -> Button:
        """Wait for the next press of a button; those from before our session or a lost connection are dropped."""
        while True:
            image = await self.until(lambda image: self._presses.waiting(image) is not None)
            if (button := self._presses.waiting(image)) is not None:  # it may have been dropped before we woke
                self._presses.take(button)
                return button

    # -- commands ------------------------------------------------------------------------------------------------

    async def command(self, command: Command, argument: int = 0) -> None:
        """Have it executed exactly once; the caller has a deadline. Raises Refused, or NoAnswer when the PLC restarts.

        When the caller gives up, what was not sent yet never will be; what was sent finishes before the next command.
        """
        image = await self.idle()
        order = self._orders.give(command, argument, image.accepted)
        self._kick()
        finished = await order.done
        if finished.result:
            raise self._orders.refusal(order, finished)

    def end_command(self, why: str) -> None:
        """Make room for a command that ends the one under way; that one's caller gets Refused."""
        self._orders.end(why)

    # -- the connection ------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Keep the exchange going, reconnecting for ever; ends only by cancellation."""
        back_off_s = FIRST_BACK_OFF_S
        try:
            while True:
                carried, since_s = self._carried, time.monotonic()
                try:
                    await self._connection()
                except DeviceError as error:
                    if self._carried > carried and time.monotonic() - since_s > STEADY_S:
                        self._lose_when_stale(error)
                        continue
                    self._lose(error)
                worked = self._carried > carried
                back_off_s = FIRST_BACK_OFF_S if worked else min(2 * back_off_s, LONGEST_BACK_OFF_S)
                await asyncio.sleep(back_off_s)
        finally:
            self._lose(LinkLost(DEVICE, "the scan has ended; start run() again"))

    async def _connection(self) -> None:
        """One connection; raises what ended it."""
        answer_within_s = ANSWER_SHARE * self._stale_after_s
        port = PlcPort(
            DEVICE, self._address, within_s=answer_within_s, transaction=self._transaction, wire_log=self._note
        )
        try:
            await port.open()
            await self._reconcile(port)
            self._cycle = PlcCycle(port, self._period_s, self._words, self._exchanged)
            await self._cycle.run()
        finally:
            self._cycle, self._transaction = None, port.transaction
            port.close()

    async def _reconcile(self, port: PlcPort) -> None:
        """Read everything; only what still makes sense is written again."""
        own = await port.cell_words()
        asked_at_s = time.monotonic()
        image, before = read_picture(await port.picture()), self._picture.image
        if image.boot != self.boot:
            if self.boot is not None:
                self._lose(self._restarted(image))
            self._adopt(own, image)
        elif before is not None:
            self._orders.resume(before.accepted, image)
        self._presses.drop(image)
        self._found()
        self._picture.anew(image, asked_at_s)
        self._written.take(own, asked_at_s)
        self._orders.settle(image, self._picture.ours(image))

    def _adopt(self, own: Sequence[int], image: PlcImage) -> None:
        """First contact, or the PLC restarted: its counters are the truth."""
        if self.boot is None:  # an earlier cellctl may have left a battery at the cup: the vacuum must not drop
            self.outputs |= Output(own[6]) & Output.VACUUM
        self._orders.restart(image.accepted, self._restarted(image).detail)
        self.boot = image.boot
        self.taken = own[7] if (image.arrival_seq - own[7]) & 0xFFFF <= 1 else image.arrival_seq

    # -- one exchange --------------------------------------------------------------------------------------------

    def _words(self) -> Sequence[int] | None:
        """Registers 0..15; none while another client is served, since its words are in our place."""
        self._begun += 1
        image = self._picture.image
        assert image is not None
        if image.session not in (0, self._session):
            return None
        self._heartbeat = (self._heartbeat + 1) & 0xFFFF
        sequence, command, argument = self._orders.shown(image, self._picture.ours(image))
        shown = self.shown
        words = CellWords(
            self._heartbeat,
            self._session,
            shown.machine_state,
            sequence,
            command,
            argument,
            int(self.outputs),  # a flag would be slow to mask
            self.taken,
            shown.good,
            shown.rejected,
        ).encode()
        self._written.take(words, time.monotonic())
        return words

    def _exchanged(self, words: Sequence[int], begun_at_s: float) -> None:
        image = read_picture(words)
        if image.boot != self.boot:
            raise self._restarted(image)
        self._picture.take(image, begun_at_s)
        ours = self._picture.ours(image)
        if not ours:
            self._presses.drop(image)
        self._orders.settle(image, ours)
        self._carried = self._begun
        self._announce()

    def _restarted(self, image: PlcImage) -> LinkLost:
        text = f"PLC restarted (boot counter in register 117 went from {self.boot} to {image.boot})"
        return LinkLost(DEVICE, text)

    def _lose_when_stale(self, error: DeviceError) -> None:
        """One lost or broken answer is nobody's business if the next connection shows the PLC in time."""
        self._losing = asyncio.get_running_loop().call_later(
            max(0.0, self._stale_after_s - self._picture.age_s), self._lose, error
        )

    def _found(self) -> None:
        """The PLC is seen again, or is given up: what was to be told when its picture is stale is settled."""
        if self._losing is not None:
            self._losing.cancel()
            self._losing = None

    def _lose(self, error: DeviceError) -> None:
        self._found()
        self._picture.down = error
        self._announce()

    def _announce(self) -> None:
        """Wake everybody whose condition holds after this exchange."""
        self.count += 1
        for condition, woken in self._waiters:
            if not woken.done() and condition():
                woken.set_result(None)

    def _note(self, sending: bool, data: bytes) -> None:
        self._packets.append((time.monotonic(), sending, data))

    def _kick(self) -> None:
        """Have the next exchange now."""
        if self._cycle is not None:
            self._cycle.kick()
