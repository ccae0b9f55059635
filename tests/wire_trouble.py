"""What can happen to a message on a wire, and what a message is. Pure; the fault proxy carries it out."""

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

Framing = Callable[[bytes], tuple[list[bytes], bytes]]  # received so far -> whole messages, the rest
SHARES = ("lose", "duplicate", "stale", "flip", "cut", "noise", "late")


def as_it_comes(received: bytes) -> tuple[list[bytes], bytes]:
    """Every piece is a message."""
    return [received], b""


def modbus_frames(received: bytes) -> tuple[list[bytes], bytes]:
    """Modbus TCP: a header of six bytes, whose last two are the length of what follows."""
    frames = []
    while len(received) >= 6 and len(received) >= (end := 6 + struct.unpack_from(">H", received, 4)[0]):
        frames.append(received[:end])
        received = received[end:]
    return frames, received


def lines(received: bytes) -> tuple[list[bytes], bytes]:
    """Text that ends in a line feed."""
    *whole, rest = received.split(b"\n")
    return [line + b"\n" for line in whole], rest


@dataclass
class Trouble:
    """What happens to the messages of one direction. Shares are probabilities of a message, from 0 to 1."""

    lose: float = 0.0  # share that never arrives
    duplicate: float = 0.0  # share that arrives twice
    stale: float = 0.0  # share in whose place the message before arrives once more
    flip: float = 0.0  # share in which one bit is turned
    cut: float = 0.0  # share that loses its end
    noise: float = 0.0  # share with random bytes before it
    late: float = 0.0  # share that comes `late_s` later, while those behind it do not wait: reordered
    late_s: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0  # up to so much more; the order is kept
    split_bytes: int = 0  # every message arrives in pieces of at most so many bytes
    split_gap_s: float = 0.001
    merge_s: float = 0.0  # what comes within this time arrives in one piece
    count: int | None = None  # it ends after so many messages, whatever happened to them


class Fate(NamedTuple):
    """What becomes of one message."""

    names: tuple[str, ...]  # of the shares that it fell into
    arrives: list[bytes]
    wait_s: float


def fate(trouble: Trouble, message: bytes, before: bytes, chance: random.Random) -> Fate:
    """Draw what becomes of `message`, which follows `before`.

    The number of draws does not depend on the trouble, so that one accident does not shift the others.
    """
    drawn = [chance.random() for _ in SHARES]
    where, wait_s = chance.random(), trouble.delay_s + trouble.jitter_s * chance.random()
    noise = chance.randbytes(20)
    names = tuple(name for name, share in zip(SHARES, drawn, strict=True) if share < getattr(trouble, name))
    if "lose" in names:
        return Fate(names, [], wait_s)
    if "stale" in names:
        message = before
    if "flip" in names:
        message = _turned(message, int(where * len(message) * 8))
    if "cut" in names:
        message = message[: int(where * len(message))]
    if "noise" in names:
        message = noise[: 1 + int(where * len(noise))] + message
    return Fate(names, [message] * (2 if "duplicate" in names else 1), wait_s + trouble.late_s * ("late" in names))


def _turned(message: bytes, bit: int) -> bytes:
    at = bit // 8
    return message[:at] + bytes(byte ^ 1 << bit % 8 for byte in message[at : at + 1]) + message[at + 1 :]
