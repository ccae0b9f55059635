"""GigE Vision stream protocol, the camera's end: a picture as packets, and their way onto the wire.

A real gigabit link cannot deliver faster than the receiver's socket drains; a loopback link can, and what does not
fit the receiver's buffer is lost without a word. So where the kernel tells how much room there is (Linux, receiver on
this machine), the sender sends so much and waits for more; elsewhere it keeps to `PACE_BPS`, in small groups. All is
done by one system call per group, without copying the pixels and without the interpreter lock.
"""

import ctypes
import errno
import socket
import struct
import sys
import time
from collections import OrderedDict
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulators.genicam import MONO8
from simulators.gvcp import Status

PACKET_OVERHEAD = 36  # IP, UDP and stream headers
UDP_OVERHEAD = 28
LEADER, TRAILER, PAYLOAD = 0x01000000, 0x02000000, 0x03000000
IMAGE, CHUNKS = 1, 0x4000  # payload type, and what is added to it when chunks follow
PACE_BPS = 2.5e9
BLIND_GROUP_BYTES = 96_000  # half a stock receive buffer of 212,992 bytes, as the kernel counts
USABLE = 0.8  # of what is free in the receiver's buffer
KEPT_BLOCKS = 4  # pictures that can be asked for again
LONGEST_STALL_S = 0.05  # a receiver that does not read for so long loses packets, as from a real camera
SHORTEST_NAP_S = 0.00005
SPREAD_S = 0.001  # packets that are to be spread over time go in groups of so long
IP_MTU_DISCOVER, IP_PMTUDISC_DO = 10, 2

Order = NDArray[np.int64]  # packet numbers in the order of sending
Target = tuple[str, int]


class Picture(NamedTuple):
    """What a leader says about a picture, and its bytes."""

    data: NDArray[np.uint8]  # (bytes,)
    ticks: int  # camera clock at the start of exposure
    offset_x: int
    offset_y: int
    width: int
    height: int  # as announced; there may be fewer lines (a fault)
    pixel_format: int = MONO8
    has_chunks: bool = False


class Block:
    """One picture as packets 0 (leader), 1..n (payload), n+1 (trailer), ready for `sendmmsg`.

    `_messages` is an array of `struct mmsghdr` (8 words each), which points into `_parts`, an array of `struct iovec`
    (2 words each, 2 to a packet: header and data), which points into `_headers` and the pixels.
    """

    def __init__(self, number: int, picture: Picture, packet_size: int, target: Target) -> None:
        self.number = number
        self.picture = picture
        chunk = packet_size - PACKET_OVERHEAD
        pixels = np.ascontiguousarray(picture.data)
        payloads = -(-pixels.size // chunk)
        self.last = payloads + 1
        self.resent = 0  # packets so far
        self.sendable = -1  # highest number that was sent: one that was not yet cannot be sent again
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
        height, width = picture.height, picture.width
        ticks = divmod(picture.ticks, 1 << 32)
        place = (width, height, picture.offset_x, picture.offset_y)
        kind = IMAGE | CHUNKS if picture.has_chunks else IMAGE
        leader = struct.pack(">HHIIIIIIIHH", 0, kind, *ticks, picture.pixel_format, *place, 0, 0)
        return leader, struct.pack(">HHI", 0, kind, height)

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

    def sizes(self, order: Order) -> Order:
        """Bytes of these packets on the network, with all their headers."""
        sizes: Order = self._parts[order, 1, 1].astype(np.int64) + PACKET_OVERHEAD
        return sizes

    def order(self) -> Order:
        """All packet numbers."""
        return np.arange(self.last + 1)


def _socket_address(target: Target) -> bytes:
    return struct.pack("=H", socket.AF_INET) + struct.pack(">H", target[1]) + socket.inet_aton(target[0]) + bytes(8)


def unavailable(number: int, packet: int) -> bytes:
    """The packet that says that a picture's packets from this one on are not in memory any more."""
    return struct.pack(">HHI", Status.PACKET_UNAVAILABLE, number, PAYLOAD + packet)


class ReceiverBuffer:
    """How full the receive buffer of a socket on this machine is (Linux socket diagnostics over netlink)."""

    REQUEST = struct.Struct("=IHHIIBBBBI")
    SOCKET_ID = struct.Struct(">HH4s12x4s12xI8s")
    BY_FAMILY, ASK, MEMORY = 20, 1, 7
    MESSAGE_BYTES, HEADER_BYTES = 72, 16

    def __init__(self) -> None:
        self._link: socket.socket | None = None
        with suppress(OSError):
            self._link = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 4)
            self._link.settimeout(0.01)

    def close(self) -> None:
        """Let the kernel's end go."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def room(self, sender: Target, receiver: Target) -> tuple[int, int] | None:
        """(free, whole) in bytes as the kernel counts them, or None where nothing is known of that socket."""
        if self._link is None:
            return None
        ends = socket.inet_aton(sender[0]), socket.inet_aton(receiver[0])
        ask = self.SOCKET_ID.pack(sender[1], receiver[1], *ends, 0, b"\xff" * 8)
        length, which = self.REQUEST.size + len(ask), (socket.AF_INET, socket.IPPROTO_UDP, 1 << (self.MEMORY - 1), 0)
        try:
            self._link.send(self.REQUEST.pack(length, self.BY_FAMILY, self.ASK, 1, 0, *which, 0xFFFFFFFF) + ask)
            reply = self._link.recv(1024)
        except OSError:
            return None
        return self._memory(reply)

    def _memory(self, reply: bytes) -> tuple[int, int] | None:
        """The first two numbers of the memory attribute: bytes used, bytes allowed."""
        at = self.HEADER_BYTES + self.MESSAGE_BYTES
        while at + 12 <= len(reply):
            length, kind = struct.unpack_from("=HH", reply, at)
            if kind == self.MEMORY:
                used, whole = struct.unpack_from("=II", reply, at + 4)
                return whole - used, whole
            at += max(4, (length + 3) & ~3)
        return None


class Sender:
    """The camera's stream socket. `send` is for one worker thread; all else for the event loop."""

    def __init__(self, ip: str) -> None:
        if sys.maxsize < 2**32 or sys.byteorder != "little" or not sys.platform.startswith("linux"):
            raise OSError(f"the simulated camera needs 64-bit little-endian Linux (this is {sys.platform})")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((ip, 0))
        self._socket.setsockopt(socket.IPPROTO_IP, IP_MTU_DISCOVER, IP_PMTUDISC_DO)
        self._source: Target = self._socket.getsockname()
        self._buffer = ReceiverBuffer()
        self._blocks: OrderedDict[int, Block] = OrderedDict()
        self._sendmmsg = ctypes.CDLL(None, use_errno=True).sendmmsg
        self._sendmmsg.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int]

    def close(self) -> None:
        """Close the sockets. No `send` may be under way."""
        self._buffer.close()
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
        done, due_s = 0, time.monotonic()
        give_up_s = due_s + LONGEST_STALL_S
        while done < len(messages):
            allowed, pace_s = self._allowed(block.packet_size, target)
            if not allowed and time.monotonic() < give_up_s:
                time.sleep(SHORTEST_NAP_S)
                continue
            most = max(1, int(SPREAD_S / delay_s)) if delay_s else len(messages)
            part = messages[done : done + min(allowed or len(messages), most)]
            self._transmit(part)
            done += len(part)
            block.sendable = max(block.sendable, int(order[done - 1]))
            due_s += len(part) * (delay_s + pace_s)
            give_up_s = time.monotonic() + LONGEST_STALL_S
            time.sleep(max(0.0, due_s - time.monotonic()) if delay_s or pace_s else 0.0)

    def _allowed(self, packet_size: int, target: Target) -> tuple[int, float]:
        """How many packets may go at once (0: wait), and the time that each has to take (s)."""
        room = self._buffer.room(self._source, target)
        if room is None:
            return max(1, BLIND_GROUP_BYTES // packet_size), packet_size * 8 / PACE_BPS
        free, whole = room
        worth_it = free * 3 >= whole
        return max(1, int(free * USABLE) // _charge(packet_size)) if worth_it else 0, 0.0

    def _transmit(self, messages: NDArray[np.uint64]) -> None:
        """Hand packets to the kernel; one that the kernel refuses (too large, no route) is lost, as on a wire."""
        at = 0
        while at < len(messages):
            start = messages.ctypes.data + at * messages.strides[0]
            done = self._sendmmsg(self._socket.fileno(), start, min(1024, len(messages) - at), 0)
            interrupted = done < 0 and ctypes.get_errno() == errno.EINTR
            at += 0 if interrupted else max(done, 1)


def _charge(packet_size: int) -> int:
    """What the kernel counts a packet in a receive buffer for: its memory comes in powers of two up to 16 KiB."""
    needed = packet_size + 320
    return 256 + (1 << (needed - 1).bit_length() if needed <= 16384 else needed + needed // 16)
