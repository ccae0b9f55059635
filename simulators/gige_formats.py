"""What a simulated camera's sensor saw, as the bytes of a pixel format. Pure.

Sources: PFNC 2.4 and GigE Vision 2.0. In the "p" formats the bits of all pixels follow each other, lowest bit first;
in the "Packed" ones two pixels share three bytes, the low bits of both in the middle one.
"""

import math

import numpy as np
from numpy.typing import NDArray

from simulators.genicam import PIXEL_FORMATS

Seen = NDArray[np.uint8] | NDArray[np.uint16]
BITS = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono16": 16}
BLACK, WHITE, RAMP, RAMP_MOVING = 1, 2, 3, 4  # test patterns, as numbered in the register
NAMES = {code: name for name, code in PIXEL_FORMATS.items()}


def pattern(number: int, size: tuple[int, int], step: int) -> NDArray[np.uint8]:
    """One of the camera's own test pictures of (height, width): black, white, a grey ramp, one that moves by `step`."""
    if number in (BLACK, WHITE):
        return np.full(size, 255 if number == WHITE else 0, np.uint8)
    ramp = np.arange(size[1]) + (step if number == RAMP_MOVING else 0)
    return np.broadcast_to(ramp.astype(np.uint8), size)


def pack(seen: Seen, code: int) -> NDArray[np.uint8]:
    """The bytes of a picture. `seen` is 8 bit, or 16 bit over the whole range of the sensor."""
    name = NAMES[code]
    if name == "Mono8" and seen.dtype == np.uint8:
        return np.ascontiguousarray(seen, np.uint8).reshape(-1)
    bits = BITS[name.removesuffix("Packed").removesuffix("p")]
    values = _of_bits(seen.reshape(-1), bits)
    if name.endswith("Packed"):
        return _pairs(values, bits)
    if name.endswith("p"):
        return _stream(values, bits)
    return values.astype(np.uint8) if bits == 8 else values.astype("<u2").view(np.uint8)


def _of_bits(seen: Seen, bits: int) -> NDArray[np.uint16]:
    """A brighter format shows more steps between the same black and white."""
    deep = seen if seen.dtype == np.uint16 else seen.astype(np.uint16) * np.uint16(257)
    return (deep >> np.uint16(16 - bits)).astype(np.uint16)


def _stream(values: NDArray[np.uint16], bits: int) -> NDArray[np.uint8]:
    """Groups of pixels that fill whole bytes, each as one large number, lowest byte first."""
    each = 8 // math.gcd(8, bits)
    groups = np.zeros((-(-values.size // each), each), np.uint16)
    groups.reshape(-1)[: values.size] = values
    numbers = np.zeros(len(groups), "<u8")
    for place in range(each):
        numbers |= groups[:, place].astype(np.uint64) << np.uint64(place * bits)
    packed = numbers.view(np.uint8).reshape(-1, 8)[:, : each * bits // 8]
    return packed.reshape(-1)[: (values.size * bits + 7) // 8]


def _pairs(values: NDArray[np.uint16], bits: int) -> NDArray[np.uint8]:
    even = np.append(values, np.uint16(0)) if values.size % 2 else values
    low = (even & np.uint16((1 << bits - 8) - 1)).reshape(-1, 2)
    high = (even >> np.uint16(bits - 8)).reshape(-1, 2)
    packed = np.stack([high[:, 0], low[:, 0] | low[:, 1] << np.uint16(4), high[:, 1]], axis=1).astype(np.uint8)
    return packed.reshape(-1)[: (values.size * 12 + 7) // 8]
