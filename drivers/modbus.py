"""One Modbus TCP connection whose every failure is a typed error.

One question at a time. Its answer is judged to the last byte by modbus_frames; a bad one, a late one, a broken
connection and a question that was given up close the connection, so no answer can ever meet a later question.

Written by hand, since a client library's exchange alone costs more than the whole scan may (5.9 % of a core at 10 ms
with pymodbus, 2.9 % for the bare bytes), and its leniency had to be undone anyway.
"""

import asyncio
from collections.abc import Callable, Sequence
from typing import cast

from drivers import modbus_frames as frames
from drivers.errors import DeviceError, Garbled, LinkLost, NoAnswer, Refused

CONNECT_WITHIN_S = 0.5
EXCEPTION_NAMES = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "server device failure",
    5: "acknowledge",
    6: "server device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target device failed to respond",
}
REMEDIES = {
    1: 'the PLC lacks this function code; if it is FC23 set exchange = "fc3+fc16"',
    2: "the PLC does not offer these registers; load the program with the right register map, or set where they begin",
    11: "check the configured unit id",
}
WireLog = Callable[[bool, bytes], None]
"""Told of every packet before it is sent (True) and as it is received (False)."""


class ModbusLink(asyncio.Protocol):
    """One connection from open to close; after any error it is closed and cannot be used again.

    `within_s` is the deadline of one request. Transaction numbers follow on `transaction`: pass the last one of the
    connection before, then even an answer that a gateway kept from there is told from a right one.
    """

    def __init__(
        self,
        device: str,
        host: str,
        port: int,
        *,
        unit_id: int = 1,
        within_s: float = 0.2,
        transaction: int = 0,
        wire_log: WireLog | None = None,
    ) -> None:
        self.transaction = transaction  # of the last question
        self._device = device
        self._host, self._port = host, port
        self._peer = f"{host}:{port}"
        self._unit_id = unit_id
        self._within_s = within_s
        self._log = wire_log
        self._transport: asyncio.Transport | None = None
        self._error: DeviceError | None = None
        self._question: frames.Question | None = None
        self._answer: frames.Answer | None = None
        self._over: Callable[[], None] = lambda: None
        self._watchdog: asyncio.TimerHandle | None = None
        self._due_s = 0.0
        self._received = b""

    async def open(self) -> None:
        """Connect; raises LinkLost."""
        try:
            async with asyncio.timeout(CONNECT_WITHIN_S):
                await asyncio.get_running_loop().create_connection(lambda: self, self._host, self._port)
        except OSError:  # TimeoutError is one, too
            self.close()
            remedy = "check address, cable and power"
            raise LinkLost(self._device, f"no connection to {self._peer} (Modbus TCP); {remedy}") from None

    def close(self) -> None:
        """Let the connection go at once. May be called at any time, also twice."""
        self._fail(LinkLost(self._device, f"connection to {self._peer} is closed"))

    async def read(self, address: int, count: int) -> list[int]:
        """FC3: `count` holding registers. Raises LinkLost, NoAnswer, Garbled, Refused, like all that ask."""
        return list(await self.ask(frames.read(address, count)))

    async def write(self, address: int, words: Sequence[int]) -> None:
        """FC16: write holding registers."""
        await self.ask(frames.write(address, words))

    async def read_write(self, read_address: int, count: int, write_address: int, words: Sequence[int]) -> list[int]:
        """FC23: write, then read, in one exchange."""
        return list(await self.ask(frames.read_write(read_address, count, write_address, words)))

    async def ask(self, request: frames.Request) -> Sequence[int]:
        """Any request; the words that it reads."""
        over = asyncio.get_running_loop().create_future()
        self.begin(request, lambda: None if over.done() else over.set_result(None))
        try:
            await over
        finally:
            if self._question is not None:  # given up: its answer must never meet a later question
                self.close()
        return self.outcome()

    def begin(self, request: frames.Request, over: Callable[[], None], *, goes_on: bool = False) -> None:
        """Ask without a task to wait in: `over` is called once, when `outcome` is known, within the deadline.

        `goes_on`: this question belongs to the one before, and both together have one deadline.
        """
        assert self._question is None, "one question at a time"
        loop = asyncio.get_running_loop()
        self._over, self._answer = over, None
        if self._error is not None or self._transport is None:
            self._error = self._error or LinkLost(self._device, f"not connected to {self._peer}")
            loop.call_soon(over)
            return
        self.transaction = (self.transaction + 1) & 0xFFFF
        self._question = frames.Question(self.transaction, self._unit_id, request)
        if not goes_on:
            self._due_s = loop.time() + self._within_s
        if self._watchdog is None:
            self._watchdog = loop.call_at(self._due_s, self._watch)
        self._send(self._question.frame)

    @property
    def well(self) -> bool:
        """Whether the last question was answered, and another may be asked."""
        return self._answer is not None and self._error is None

    def outcome(self) -> Sequence[int]:
        """The words that the last question read; raises what went wrong instead."""
        if self._answer is None:
            assert self._error is not None, "no question is over"
            raise self._error.with_traceback(None)
        return self._answer.words

    def _send(self, frame: bytes) -> None:
        assert self._transport is not None
        if self._log is not None:
            self._log(True, frame)
        self._transport.write(frame)

    def _watch(self) -> None:
        """One timer for many questions: it goes on to the deadline of the one that is asked now."""
        self._watchdog = None
        if self._question is None:
            return
        loop = asyncio.get_running_loop()
        if loop.time() < self._due_s:
            self._watchdog = loop.call_at(self._due_s, self._watch)
            return
        late = f"no answer within {self._within_s * 1000:.0f} ms; check the network"
        self._fail(NoAnswer(self._device, f"{self._question.request} at {self._peer}: {late}"))

    def _fail(self, error: DeviceError) -> None:
        """Remember the first cause, let the connection go and end the question now."""
        self._error = self._error or error
        if self._transport is not None:
            self._transport.abort()  # do not linger on unsent bytes
        if self._watchdog is not None:
            self._watchdog.cancel()
        self._end_question()

    def _end_question(self) -> None:
        if self._question is None:
            return
        self._question, self._received = None, b""
        self._over()

    # -- what the event loop calls -----------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The connection stands."""
        self._transport = cast(asyncio.Transport, transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """It broke, or was closed by either side."""
        self._fail(LinkLost(self._device, f"connection to {self._peer} was closed by the other side"))

    def data_received(self, data: bytes) -> None:
        """Bytes came: part of an answer, a whole one, or something else."""
        if self._log is not None:
            self._log(False, data)
        self._received += data
        if self._question is None:
            self._fail(self._garbled(f"{len(data)} bytes that were not asked for"))
            return
        try:
            answer = self._question.answered_by(self._received)
        except frames.NotTheAnswer as wrong:
            self._fail(self._garbled(str(wrong)))
            return
        if answer is not None:
            self._take(answer)

    def _take(self, answer: frames.Answer) -> None:
        if answer.exception:
            self._fail(self._refusal(answer.exception))
        else:
            self._answer = answer
            self._end_question()

    def _garbled(self, wrong: str) -> Garbled:
        start = self._received[:16].hex(" ")
        return Garbled(self._device, f"answer from {self._peer} has {wrong}: {start}; is it a Modbus server?")

    def _refusal(self, code: int) -> Refused:
        assert self._question is not None
        name = EXCEPTION_NAMES.get(code, "unknown exception")
        remedy = REMEDIES.get(code, "look at the PLC's own diagnostics")
        said = f"{self._question.request} at {self._peer}: {name}; {remedy}"
        return Refused(self._device, f"exception {code}", said)
