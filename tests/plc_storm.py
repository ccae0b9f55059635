"""Answers that come late, twice or out of turn, thousands of them, at many clients; and what the clients took.

A gateway stands in for the wire: it may answer after the client has given up (on the next connection, if the first is
closed by then), answer twice, or hand out the answer before once more. Every picture shows the word that the very
request wrote, so a client that takes the answer to another question sees it at once.
"""

import asyncio
import random
import struct
from collections import Counter
from collections.abc import Callable, Sequence

from drivers.errors import DeviceError
from drivers.plc_layout import PlcAddress
from drivers.plc_port import PlcPort

ANSWER_WITHIN_S, LATE_S = 0.03, 0.045
CLIENTS = 20


class Gateway(asyncio.Protocol):
    """One connection. `late` are answers that an earlier connection did not live to see."""

    def __init__(self, chance: random.Random, late: list[bytes], done: Counter[str]) -> None:
        self._chance, self._late, self._done = chance, late, done
        self._before = b""
        self._received = b""
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None

    def data_received(self, data: bytes) -> None:
        self._received += data
        while len(self._received) >= 6 and len(self._received) >= (end := 6 + self._received[5]):
            request, self._received = self._received[:end], self._received[end:]
            self._serve(request)

    def _serve(self, request: bytes) -> None:
        word = request[17:19]  # the first of those that are written
        answer = request[:4] + struct.pack(">HBBB", 67, request[6], 23, 64) + 32 * word
        before, self._before = self._before, answer
        lot = self._chance.random()
        if lot < 0.4:
            self._send("right", answer)
        elif lot < 0.6:
            self._send("doubled", 2 * answer)
        elif lot < 0.8 and before:
            self._send("out of turn", before)
        elif lot < 0.9 and self._late:
            self._send("late, on another connection", self._late.pop())
        else:
            asyncio.get_running_loop().call_later(LATE_S, self._send_late, answer)

    def _send_late(self, answer: bytes) -> None:
        if self._transport is None:
            self._late.append(answer)
        else:
            self._send("late", answer)

    def _send(self, what: str, data: bytes) -> None:
        assert self._transport is not None
        self._done[what] += 1
        self._transport.write(data)


async def exchange(port: PlcPort, words: list[int]) -> Sequence[int]:
    """One, waited for."""
    over = asyncio.get_running_loop().create_future()
    port.begin(words, lambda: over.set_result(None))
    await over
    return port.outcome()


async def storm(
    bad_answers: int, progress: Callable[[int], None] = lambda bad: None
) -> tuple[Counter[str], Counter[str]]:
    """What was sent, and what the clients made of it: pictures "right" and "wrong", and errors by their names."""
    sent: Counter[str] = Counter()
    taken: Counter[str] = Counter()
    late: list[bytes] = []
    chance = random.Random(7)
    server = await asyncio.get_running_loop().create_server(lambda: Gateway(chance, late, sent), "127.0.0.1", 0)
    address = PlcAddress("127.0.0.1", server.sockets[0].getsockname()[1])

    def bad() -> int:
        return sent.total() - sent["right"]

    async def client(number: int) -> None:
        transaction = number * 3000
        while bad() < bad_answers:
            port = PlcPort("plc", address, within_s=ANSWER_WITHIN_S, transaction=transaction)
            try:
                await port.open()
                while bad() < bad_answers:
                    word = chance.randrange(0x10000)
                    picture = await exchange(port, [word] + 15 * [0])
                    taken["right" if set(picture) == {word} else "wrong"] += 1
            except DeviceError as error:
                taken[type(error).__name__] += 1
            finally:
                transaction = port.transaction
                port.close()
            progress(bad())

    try:
        async with asyncio.TaskGroup() as group:
            for number in range(CLIENTS):
                group.create_task(client(number))
    finally:
        server.close()
        await asyncio.sleep(2 * LATE_S)  # what was still to come late
    return sent, taken
