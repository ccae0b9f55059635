"""Modbus TCP frames: a stream of bytes in, requests out. Pure.

Source: MODBUS Messaging on TCP/IP Implementation Guide V1.0b, sections 3.1.3 (header) and 4.4.1.1 (its check).
"""

import struct
from typing import NamedTuple

HEADER_SIZE = 7
LONGEST_PDU = 253
LONGEST_FRAME = HEADER_SIZE + LONGEST_PDU
PROTOCOL = 0


class Request(NamedTuple):
    """One frame, from either side. `pdu` has at least its function code."""

    transaction: int
    unit: int
    pdu: bytes


class BadFrame(Exception):
    """No frame has this length: where the next one begins is unknown, so the connection must be closed."""


def split_frames(data: bytes) -> tuple[list[Request], bytes]:
    """The whole frames at the start of `data`, and what is left over, which is shorter than a frame.

    A frame of another protocol is discarded without a word, as the guide says. Raises BadFrame.
    """
    requests = []
    at = 0
    while len(data) - at >= HEADER_SIZE - 1:
        transaction, protocol, length = struct.unpack_from(">HHH", data, at)
        if not 2 <= length <= LONGEST_PDU + 1:
            raise BadFrame(f"length {length}")
        end = at + HEADER_SIZE - 1 + length
        if len(data) < end:
            break
        if protocol == PROTOCOL:
            requests.append(Request(transaction, data[at + 6], data[at + HEADER_SIZE : end]))
        at = end
    return requests, data[at:]


def frame(request: Request) -> bytes:
    """As it goes over the wire."""
    return struct.pack(">HHHB", request.transaction, PROTOCOL, len(request.pdu) + 1, request.unit) + request.pdu
