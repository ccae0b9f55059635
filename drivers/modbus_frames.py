"""Modbus TCP as a client sees it: questions as bytes, answers judged to the last byte. Pure.

Sources: MODBUS Application Protocol V1.1b3 (function codes 3, 4, 16, 23) and MODBUS Messaging on TCP/IP V1.0b (header).
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

READ_HOLDING, READ_INPUT, WRITE, READ_WRITE = 3, 4, 16, 23
EXCEPTION = 0x80  # bit of the function code
HEADER_SIZE = 7
SHORTEST_ANSWER = 9  # header, function, exception code
EXCEPTION_LENGTH = 3  # as the header counts: unit, function, exception code


class NotTheAnswer(Exception):
    """These bytes are not the answer to the question, and no further bytes can make them one."""


class Answer(NamedTuple):
    """What came back: words read (none for a write), or an exception code."""

    words: tuple[int, ...] = ()
    exception: int = 0


class Request(NamedTuple):
    """What is asked, whoever asks it: the request's PDU, how the answer's PDU begins, and its size in bytes."""

    pdu: bytes
    answer_begins: bytes
    answer_size: int

    def __str__(self) -> str:
        return said(self.pdu)


def read(address: int, count: int, function: int = READ_HOLDING) -> Request:
    """FC3, or FC4 for input registers."""
    return Request(struct.pack(">BHH", function, address, count), bytes((function, 2 * count)), 2 + 2 * count)


def write(address: int, words: Sequence[int]) -> Request:
    """FC16. The answer repeats address and count."""
    head = struct.pack(">BHH", WRITE, address, len(words))
    return Request(head + struct.pack(f">B{len(words)}H", 2 * len(words), *words), head, 5)


def read_write(read_address: int, count: int, write_address: int, words: Sequence[int]) -> Request:
    """FC23: the server writes before it reads."""
    head = struct.pack(">BHHHHB", READ_WRITE, read_address, count, write_address, len(words), 2 * len(words))
    return Request(head + struct.pack(f">{len(words)}H", *words), bytes((READ_WRITE, 2 * count)), 2 + 2 * count)


def said(pdu: bytes) -> str:
    """A request in words, such as "FC3 reading registers 100..131"."""
    if pdu[0] == READ_WRITE:
        at, count, write_at, write_count = struct.unpack_from(">HHHH", pdu, 1)
        return f"FC23 reading {_span(at, count)} and writing {_span(write_at, write_count)}"
    at, count = struct.unpack_from(">HH", pdu, 1)
    doing = {READ_HOLDING: "reading", READ_INPUT: "reading input", WRITE: "writing"}[pdu[0]]
    return f"FC{pdu[0]} {doing} {_span(at, count)}"


def _span(address: int, count: int) -> str:
    return f"registers {address}..{address + count - 1}"


class Question:
    """One request on its way, under a transaction number to a unit."""

    def __init__(self, transaction: int, unit: int, request: Request) -> None:
        self.transaction, self.unit, self.request = transaction, unit, request
        pdu, begins, size = request
        self.frame = struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu
        self._head = struct.pack(">HHHB", transaction, 0, size + 1, unit) + begins
        self._size = HEADER_SIZE + size

    def answered_by(self, received: bytes) -> Answer | None:
        """The answer, or None while it is not whole. Raises NotTheAnswer, which says what is wrong."""
        if len(received) == self._size and received.startswith(self._head):
            return Answer(self._words(received))
        if len(received) < SHORTEST_ANSWER:
            return None
        self._check_header(received)
        if received[7] & EXCEPTION:
            if received[8] == 0:
                raise NotTheAnswer("exception code 0, which does not exist")
            return Answer(exception=received[8])
        self._check_body(received)
        return None

    def _words(self, received: bytes) -> tuple[int, ...]:
        if self.request.pdu[0] == WRITE:
            return ()
        return struct.unpack_from(f">{(self._size - SHORTEST_ANSWER) // 2}H", received, SHORTEST_ANSWER)

    def _check_header(self, received: bytes) -> None:
        transaction, protocol, length, unit, function = struct.unpack_from(">HHHBB", received)
        wanted_length = EXCEPTION_LENGTH if function & EXCEPTION else self.request.answer_size + 1
        for name, found, wanted in (
            ("protocol id", protocol, 0),
            ("transaction", transaction, self.transaction),
            ("unit", unit, self.unit),
            ("function", function & ~EXCEPTION, self.request.pdu[0]),
            ("length", length, wanted_length),
        ):
            if found != wanted:
                raise NotTheAnswer(f"{name} {found} instead of {wanted}")
        if len(received) > 6 + length:
            raise NotTheAnswer(f"{len(received) - 6 - length} bytes too many")

    def _check_body(self, received: bytes) -> None:
        """The byte count of a reading answer, address and count of a writing one."""
        found, wanted = received[8 : len(self._head)], self._head[8:]
        if wanted.startswith(found):
            return
        if self.request.pdu[0] != WRITE:
            raise NotTheAnswer(f"byte count {found[0]} instead of {wanted[0]}")
        raise NotTheAnswer(f"address and count {found.hex(' ')} instead of {wanted.hex(' ')}")
