"""GigE Vision stream protocol, the camera's end: a picture as packets, and their way onto the wire.

A real gigabit link cannot deliver faster than the receiver's socket drains; a loopback link can, and what does not
fit the receiver's buffer is lost without a word. So the sender sends in small groups and, where the kernel tells how
much the receiver has not yet read (Linux, receiver on this machine), lets no more than two groups pile up. Elsewhere it
keeps to `PACE_BPS`. All is done by one system call per group, without copying the pixels and without the interpreter lock.
"""

import ctypes
import errno
import socket
import struct
import sys
import time
from collections import OrderedDict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulators.genicam import MONO8
from simulators.gvcp import Status

PACKET_OVERHEAD = 36  # IP, UDP and stream headers
UDP_OVERHEAD = 28
LEADER, TRAILER, PAYLOAD = 0x01000000, 0x02000000, 0x03000000
IMAGE = 1  # payload type
PACE_BPS = 2.5e9
GROUP_BYTES = 96_000  # two groups fit the stock receive buffer of 212,992 bytes, as the kernel counts them
KEPT_BLOCKS = 4  # pictures that can be asked for again
LONGEST_STALL_S = 0.05  # a receiver that does not read for so long loses packets, as from a real camera
SHORTEST_NAP_S = 0.00005
IP_MTU_DISCOVER, IP_PMTUDISC_DO = 10, 2

Order = NDArray[np.int64]  # packet numbers in the order of sending
Target = tuple[str, int]


class Picture(NamedTuple):
    """What a leader says about a picture, and its pixels (height, width)."""

    pixels: NDArray[np.uint8]
    ticks: int  # camera clock at the start of exposure
    offset_x: int
    offset_y: int
    height: int  # as announced; the pixels may have fewer lines (a fault)


class Block:
    """One picture as packets 0 (leader), 1..n (payload), n+1 (trailer), ready for `sendmmsg`.

    `_messages` is an array of `struct mmsghdr` (8 words each), which points into `_parts`, an array of `struct iovec`
    (2 words each, 2 to a packet: header and data), which points into `_headers` and the pixels.
    """

    def __init__(self, number: int, picture: Picture, packet_size: int, target: Target) -> None:
        self.number = number
        self.picture = picture
        chunk = packet_size - PACKET_OVERHEAD
        pixels = np.ascontiguousarray(picture.pixels).reshape(-1)
        payloads = -(-pixels.size // chunk)
        self.last = payloads + 1
        self.sendable = payloads  # highest number that may be sent again; the trailer's turn comes last
        self.packet_size = packet_size
        head, tail = self._ends()
        self._edges = np.frombuffer(head + tail, np.uint8).copy()
        self._pixels = pixels
        self._headers = self._packet_headers(number)
        self._address = np.frombuffer(_socket_address(target), np.uint8).copy()
        self._parts = np.zeros((self.last + 1, 2, 2), np.uint64)
        self._fill_parts(chunk, len(head), len(tail))
        self._messages = self._message_table()

    def _ends(self) -> tuple[bytes, bytes]:
        picture = self.picture
        height, width = picture.height, picture.pixels.shape[1]
        ticks = divmod(picture.ticks, 1 << 32)
        place = (width, height, picture.offset_x, picture.offset_y)
        leader = struct.pack(">HHIIIIIIIHH", 0, IMAGE, *ticks, MONO8, *place, 0, 0)
        return leader, struct.pack(">HHI", 0, IMAGE, height)

    def _packet_headers(self, number: int) -> NDArray[np.uint8]:
        words = np.empty((self.last + 1, 2), ">u4")
        words[:, 0] = number
        words[:, 1] = PAYLOAD + np.arange(self.last + 1)
        words[0, 1], words[-1, 1] = LEADER, TRAILER + self.last
        return words.view(np.uint8)

    def _fill_parts(self, chunk: int, leader_bytes: int, trailer_bytes: int) -> None:
        index = np.arange(self.last + 1, dtype=np.uint64)
        parts = self._parts
        parts[:, 0, 0] = self._headers.ctypes.data + 8 * index
        parts[:, 0, 1] = 8
        parts[1:-1, 1, 0] = self._pixels.ctypes.data + chunk * index[:-2]
        parts[1:-1, 1, 1] = chunk
        parts[-2, 1, 1] = self._pixels.size - chunk * (self.last - 2)
        parts[0, 1] = self._edges.ctypes.data, leader_bytes
        parts[-1, 1] = self._edges.ctypes.data + leader_bytes, trailer_bytes

    def _message_table(self) -> NDArray[np.uint64]:
        table = np.zeros((self.last + 1, 8), np.uint64)
        table[:, 0] = self._address.ctypes.data
        table[:, 1] = self._address.size
        table[:, 2] = self._parts.ctypes.data + self._parts.strides[0] * np.arange(self.last + 1, dtype=np.uint64)
        table[:, 3] = 2
        return table

    def messages(self, order: Order) -> NDArray[np.uint64]:
        """The packets with these numbers, as `struct mmsghdr` in this order; valid while the block lives."""
        return self._messages[order]

    def order(self) -> Order:
        """All packet numbers."""
        return np.arange(self.last + 1)


def _socket_address(target: Target) -> bytes:
    return struct.pack("=H", socket.AF_INET) + struct.pack(">H", target[1]) + socket.inet_aton(target[0]) + bytes(8)


def unavailable(number: int, packet: int) -> bytes:
    """The packet that says that a picture's packets from this one on are not in memory any more."""
    return struct.pack(">HHI", Status.PACKET_UNAVAILABLE, number, PAYLOAD + packet)


class ReceiverQueue:
    """How many bytes a socket on this machine has received and its owner not yet read (Linux socket diagnostics)."""

    REQUEST = struct.Struct("=IHHIIBBBBI")
    SOCKET_ID = struct.Struct(">HH4s12x4s12xI8s")
    ANSWER = struct.Struct("=4x48xII")  # in the answer's body: family and state, socket id, expiry, read queue

    def __init__(self) -> None:
        try:
            self._link: socket.socket | None = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 4)
            self._link.settimeout(0.01)
        except OSError:
            self._link = None

    def unread(self, sender: Target, receiver: Target) -> int | None:
        """Bytes as the kernel counts them, or None where nothing is known of that socket."""
        if self._link is None:
            return None
        ask = self.SOCKET_ID.pack(
            sender[1], receiver[1], socket.inet_aton(sender[0]), socket.inet_aton(receiver[0]), 0, b"\xff" * 8
        )
        head = self.REQUEST.pack(
            self.REQUEST.size + len(ask), 20, 1, 1, 0, socket.AF_INET, socket.IPPROTO_UDP, 0, 0, 0xFFFFFFFF
        )
        try:
            self._link.send(head + ask)
            reply = self._link.recv(1024)
        except OSError:
            return None
        found = len(reply) >= 16 + self.ANSWER.size and struct.unpack_from("=H", reply, 4)[0] == 20
        return int(self.ANSWER.unpack_from(reply, 16)[1]) if found else None

    def close(self) -> None:
        """Let the kernel's end go."""
        if self._link is not None:
            self._link.close()
            self._link = None


class Sender:
    """The camera's stream socket. `send` is for one worker thread; all else for the event loop."""

    def __init__(self, ip: str) -> None:
        if sys.maxsize < 2**32 or sys.byteorder != "little" or not sys.platform.startswith("linux"):
            raise OSError(f"the simulated camera needs 64-bit little-endian Linux (this is {sys.platform})")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((ip, 0))
        self._socket.setsockopt(socket.IPPROTO_IP, IP_MTU_DISCOVER, IP_PMTUDISC_DO)
        self._source: Target = self._socket.getsockname()
        self._queue = ReceiverQueue()
        self._blocks: OrderedDict[int, Block] = OrderedDict()
        self._sendmmsg = ctypes.CDLL(None, use_errno=True).sendmmsg
        self._sendmmsg.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int]

    def close(self) -> None:
        """Close the sockets. No `send` may be under way."""
        self._queue.close()
        self._socket.close()

    @property
    def port(self) -> int:
        """The port that packets come from."""
        return self._source[1]

    def keep(self, block: Block) -> None:
        """Remember a block for resending, and forget the oldest."""
        self._blocks[block.number] = block
        while len(self._blocks) > KEPT_BLOCKS:
            self._blocks.popitem(last=False)

    def kept(self, number: int) -> Block | None:
        """A block that can still be sent again."""
        return self._blocks.get(number)

    def forget(self) -> None:
        """Nothing can be sent again any more."""
        self._blocks.clear()

    def test_packet(self, size: int, target: Target) -> None:
        """One packet of `size` bytes with all headers; too large ones the network drops."""
        self.datagram(bytes(size - UDP_OVERHEAD), target)

    def datagram(self, data: bytes, target: Target) -> None:
        """One datagram; an unreachable receiver is no error to a camera."""
        try:
            self._socket.sendto(data, socket.MSG_DONTWAIT, target)
        except OSError:
            return

    def at_once(self, block: Block, order: Order) -> None:
        """Some packets without pacing."""
        self._transmit(block.messages(order))

    def send(self, block: Block, order: Order, target: Target, delay_s: float = 0.0) -> None:
        """Send packets in this order, as fast as the receiver reads them; `delay_s` per packet is added."""
        messages = block.messages(order)
        group = max(1, GROUP_BYTES // block.packet_size)
        stall_until = time.monotonic() + LONGEST_STALL_S
        due = time.monotonic()
        for first in range(0, len(messages), group):
            part = messages[first : first + group]
            self._transmit(part)
            unread = self._let_drain(target, stall_until)
            due += len(part) * delay_s
            if unread is None:
                due += len(part) * block.packet_size * 8 / PACE_BPS
            nap_s = due - time.monotonic()
            if nap_s > 0:
                time.sleep(nap_s)

    def _let_drain(self, target: Target, until_s: float) -> int | None:
        """Wait until the receiver has at most one group unread; None where the kernel does not tell."""
        unread = self._queue.unread(self._source, target)
        while unread is not None and unread > GROUP_BYTES and time.monotonic() < until_s:
            time.sleep(SHORTEST_NAP_S)
            unread = self._queue.unread(self._source, target)
        return unread

    def _transmit(self, messages: NDArray[np.uint64]) -> None:
        """Hand packets to the kernel; one that the kernel refuses (too large, no route) is lost, as on a wire."""
        at = 0
        while at < len(messages):
            start = messages.ctypes.data + at * messages.strides[0]
            done = self._sendmmsg(self._socket.fileno(), start, min(1024, len(messages) - at), 0)
            interrupted = done < 0 and ctypes.get_errno() == errno.EINTR
            at += 0 if interrupted else max(done, 1)
