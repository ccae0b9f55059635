"""A bare GigE Vision client, datagram by datagram, and a simulated camera to talk to."""

import asyncio
import itertools
import os
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Self

import numpy as np

from simulators.clock import Clock
from simulators.genicam import registers
from simulators.gige import Exposure, GigeCameraServer

SENSOR = (640, 480)
OK, PENDING, DENIED = 0, 0x0089, 0x8006
_numbers = itertools.count(1)
TABLE = registers(SENSOR, 16_000)
AT = {name: register.address for name, register in TABLE.items()}


def fresh_ip() -> str:
    """An address of this test process alone, so that test runs do not meet."""
    pid = os.getpid()
    return f"127.{(pid >> 8) % 63 + 1}.{pid & 255}.{next(_numbers) % 250 + 1}"


class Client:
    """A bare GigE Vision client: control and stream socket."""

    def __init__(self, ip: str) -> None:
        self.ip = ip
        self.control = self._socket()
        self.stream = self._socket()
        self.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._number = 0

    def _socket(self) -> socket.socket:
        end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        end.bind(("127.0.0.1", 0))
        end.setblocking(False)
        return end

    async def receive(self, end: socket.socket, within_s: float = 1.0) -> bytes:
        async with asyncio.timeout(within_s):
            return await asyncio.get_running_loop().sock_recv(end, 70_000)

    def send(self, command: int, body: bytes, *, flags: int = 1, number: int | None = None) -> None:
        self._number += 1
        head = struct.pack(">BBHHH", 0x42, flags, command, len(body), number or self._number)
        self.control.sendto(head + body, (self.ip, 3956))

    async def ask(self, command: int, body: bytes = b"", number: int | None = None) -> tuple[int, bytes]:
        """Status and body of the answer, which must be the one to this question."""
        self.send(command, body, number=number)
        reply = await self.receive(self.control)
        status, acknowledged, length, back = struct.unpack_from(">HHHH", reply)
        assert (acknowledged, length, back) == (command + 1, len(reply) - 8, number or self._number)
        return status, reply[8:]

    async def read(self, address: int) -> int:
        status, body = await self.ask(0x80, struct.pack(">I", address))
        assert status == OK
        return int(struct.unpack(">I", body)[0])

    async def memory(self, address: int, length: int) -> bytes:
        status, body = await self.ask(0x84, struct.pack(">IHH", address, 0, length))
        assert (status, body[:4]) == (OK, struct.pack(">I", address))
        return body[4:]

    async def write(self, address: int, value: int) -> int:
        return (await self.ask(0x82, struct.pack(">II", address, value)))[0]

    async def arm(self, *, trigger: bool = True, packet_size: int = 1500) -> None:
        assert await self.write(AT["GevCCP"], 2) == OK
        host, port = self.stream.getsockname()
        where = struct.unpack(">I", socket.inet_aton(host))[0]
        wanted = {"GevSCDA": where, "GevSCPHostPort": port, "GevSCPS": packet_size, "TriggerMode": int(trigger)}
        for name, value in wanted.items():
            assert await self.write(AT[name], value) == OK
        assert await self.write(AT["AcquisitionStart"], 1) == OK

    async def picture(self, within_s: float = 2.0) -> tuple[dict[str, int], np.ndarray]:
        """The next picture: what its leader says, and its pixels in the order of packet numbers."""
        packets: dict[int, bytes] = {}
        leader: dict[str, int] = {}
        while True:
            packet = await self.receive(self.stream, within_s)
            kind, number = packet[4], int.from_bytes(packet[5:8], "big")
            if kind == 1:
                names = ("high", "low", "format", "width", "height", "x", "y")
                leader = dict(zip(names, struct.unpack_from(">7I", packet, 12), strict=True))
                leader["block"] = int.from_bytes(packet[2:4], "big")
            elif kind == 3:
                packets[number] = packet[8:]
            elif kind == 2:
                assert sorted(packets) == list(range(1, number))
                pixels = np.frombuffer(b"".join(packets[n] for n in sorted(packets)), np.uint8)
                return leader, pixels.reshape(leader["height"], leader["width"])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.control.close()
        self.stream.close()


def gradient(exposure: Exposure) -> np.ndarray:
    """A scene in which each pixel's value tells its place on the sensor."""
    v, u = np.mgrid[: exposure.height, : exposure.width]
    return ((u + exposure.offset_x) * 7 + (v + exposure.offset_y) * 31).astype(np.uint8)


@asynccontextmanager
async def served(
    picture=gradient, *, speed: float = 50.0, name: str = "", clock: Clock | None = None
) -> AsyncIterator[tuple[GigeCameraServer, Client]]:
    clock = clock or Clock(speed)
    async with GigeCameraServer(fresh_ip(), "SN7", picture, clock, sensor=SENSOR, name=name) as server:
        with Client(server.ip) as client:
            yield server, client


@asynccontextmanager
async def another(ip: str) -> AsyncIterator[Client]:
    with Client(ip) as client:
        yield client
