"""A simulated camera's end of the network: pictures as packets on their way, and packets that are sent again."""

import socket
from dataclasses import dataclass

import numpy as np

from simulators import genicam, gvcp
from simulators.gige_faults import Faults
from simulators.gige_registers import Registers
from simulators.gvcp import Resend
from simulators.gvsp import Block, Order, Picture, Sender, Target, unavailable

WIRE_OVERHEAD = 1.03  # headers, and the gaps between packets
GIGABIT_MBPS = 1000.0
BLOCKS = 0xFFFF  # picture numbers go from 1 to this and begin anew
MOST_REFUSALS = 256  # in answer to one request


@dataclass
class Counts:
    """What the camera did since its start."""

    malformed: int = 0
    triggers: int = 0
    triggers_missed: int = 0
    frames: int = 0
    packets: int = 0
    packets_resent: int = 0
    controllers_refused: int = 0


class Link:
    """The stream channel. `burst` is for the camera's worker thread; all else for the event loop."""

    def __init__(self, registers: Registers, faults: Faults, counts: Counts) -> None:
        self.block_number = 0
        self._registers, self._faults, self._counts = registers, faults, counts

    def open(self, ip: str) -> None:
        """Open the stream socket."""
        self._sender = Sender(ip)

    def close(self) -> None:
        """Close it. No burst may be under way."""
        self._sender.close()

    def move(self, ip: str) -> None:
        """Send from another address; not while pictures are being taken."""
        self._sender.close()
        self._sender = Sender(ip)

    def begin_anew(self) -> None:
        """Number from 1, and send nothing again of what was before."""
        self.block_number = 0
        self._sender.forget()

    def target(self) -> Target | None:
        """Where packets go, if a client has said so."""
        port = self._registers["GevSCPHostPort"] & 0xFFFF
        return (socket.inet_ntoa(gvcp.WORD.pack(self._registers["GevSCDA"])), port) if port else None

    def wire_s(self, size_bytes: int) -> float:
        """World seconds that so much takes on the link."""
        return size_bytes * 8 * WIRE_OVERHEAD / (self._faults.link_mbps or GIGABIT_MBPS) / 1e6

    def _packet_size(self) -> int:
        return self._registers["GevSCPS"] & gvcp.PACKET_SIZE_MASK

    def _delay_s(self, speed: float) -> float:
        """Wall seconds from one packet to the next, as set by the client or by the rate of the link."""
        by_rate_s = self.wire_s(self._packet_size()) / speed if self._faults.link_mbps else 0.0
        return max(self._registers["GevSCPD"] / genicam.TICKS_PER_S, by_rate_s)

    def burst(self, picture: Picture, target: Target, speed: float) -> tuple[Block, Order]:
        """Send leader and payload. Returns the block, and the trailer if the network delivers it."""
        self.block_number = self.block_number % BLOCKS + 1
        block = Block(self.block_number, picture, self._packet_size(), target)
        self._sender.keep(block)
        order = self._faults.on_their_way(block.order(), block.sizes(block.order()))
        self._counts.packets += block.last + 1
        trailer = order == block.last
        self._sender.send(block, order[~trailer], target, self._delay_s(speed))
        return block, order[trailer]

    def end(self, block: Block, last: Order) -> None:
        """Send the trailer, if the network delivers it."""
        block.sendable = block.last
        if not self._faults.silent:
            self._sender.at_once(block, last)
            self._counts.frames += 1

    def test_packet(self) -> None:
        """One packet of the size set, to see whether the network takes it."""
        target, size = self.target(), self._packet_size()
        if target and size <= (self._faults.mtu_bytes or size):
            self._sender.test_packet(size, target)

    def resend(self, wanted: Resend) -> None:
        """Send packets again that are still in memory, and say of all others that they are not.

        Of those that were not sent yet nothing is said: they come in their turn.
        """
        target, block = self.target(), self._sender.kept(wanted.block)
        if target is None:
            return
        last = wanted.first + MOST_REFUSALS if block is None else block.sendable
        asked = np.arange(wanted.first, min(wanted.last, last) + 1)
        left = 0 if block is None else self._left_to_resend(block)
        for packet in asked[left:][:MOST_REFUSALS]:
            self._sender.datagram(unavailable(wanted.block, int(packet)), target)
        if block is not None:
            self._send_again(block, asked[:left])

    def _send_again(self, block: Block, packets: Order) -> None:
        block.resent += packets.size
        order = self._faults.resent(packets, block.sizes(packets))
        self._counts.packets_resent += order.size
        self._sender.at_once(block, order)

    def _left_to_resend(self, block: Block) -> int:
        """How many of its packets are still in memory, by the faults in force."""
        if self._faults.on("resend_unavailable"):
            return 0
        return max(0, self._faults.most_resends - block.resent) if self._faults.most_resends else block.last + 1
