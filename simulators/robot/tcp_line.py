"""One TCP connection of a client."""

import asyncio
import socket

from simulators.robot.session import Host, Session

KEEP_ALIVE_PROBES = 3


class TcpLine(asyncio.Protocol):
    """Each write is a segment of its own. `keep_alive_s`: a dead peer is noticed after so long; 0 = never."""

    can_hold = True

    def __init__(self, host: Host, *, keep_alive_s: float = 0.0) -> None:
        self._host = host
        self._keep_alive_s = keep_alive_s
        self._session = Session(host, self, kind="network")
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the client or turn it away."""
        assert isinstance(transport, asyncio.Transport)
        sock = transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._keep_alive_s:
            period_s = max(round(self._keep_alive_s / KEEP_ALIVE_PROBES), 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, period_s)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, period_s)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEP_ALIVE_PROBES - 1)
        self._transport = transport
        if not self._host.joined(self._session):
            self._transport = None
            transport.close()

    def data_received(self, data: bytes) -> None:
        """From the network."""
        if self._transport is not None:
            self._session.heard(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """The client hung up, or we did."""
        if self._transport is not None:
            self._transport = None
            self._host.left(self._session)

    def write(self, data: bytes) -> None:
        """Each call is one segment."""
        if self._transport is not None:
            self._transport.write(data)

    def hold(self, on: bool) -> None:
        """Read no more for now; the network makes the client wait."""
        if self._transport is not None and not self._transport.is_closing():
            (self._transport.pause_reading if on else self._transport.resume_reading)()

    def hang_up(self) -> None:
        """Say good-bye."""
        if self._transport is not None:
            self._transport.close()

    def drop(self) -> None:
        """Cut the connection."""
        if self._transport is not None:
            self._transport.abort()
