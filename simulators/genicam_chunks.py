"""Chunks: what a camera says of a picture behind its pixels, and how a client's description finds it there. Pure.

A chunk is its data, then its number and its length, both big-endian; the first chunk is the picture itself (GigE
Vision 2.0, extended chunk data). A port with a chunk number in the GenICam description stands for the chunk's data.
"""

import struct

import numpy as np
from numpy.typing import NDArray

PICTURE, EXPOSURE, GAIN = 0x1000, 0x1001, 0x1002
VALUE = struct.Struct("<d")
TAG = struct.Struct(">II")
BYTES = 3 * TAG.size + 2 * VALUE.size
NAMES = {"ChunkExposureTime": (EXPOSURE, "us"), "ChunkGain": (GAIN, "dB")}


def with_chunks(pixels: NDArray[np.uint8], exposure_us: float, gain_db: float) -> NDArray[np.uint8]:
    """The picture's bytes and, behind them, its exposure and gain."""
    chunks = TAG.pack(PICTURE, pixels.size)
    for number, value in ((EXPOSURE, exposure_us), (GAIN, gain_db)):
        chunks += VALUE.pack(value) + TAG.pack(number, VALUE.size)
    return np.concatenate([pixels, np.frombuffer(chunks, np.uint8)])


def features() -> list[str]:
    """The values of the chunks and the ports behind which they are, as XML."""
    nodes = []
    for name, (number, unit) in NAMES.items():
        nodes.append(f'<Port Name="{name}Port" NameSpace="Custom"><ChunkID>{number:x}</ChunkID></Port>')
        nodes.append(
            f'<FloatReg Name="{name}" NameSpace="Standard"><Address>0</Address><Length>{VALUE.size}</Length>'
            f"<AccessMode>RO</AccessMode><pPort>{name}Port</pPort><Cachable>NoCache</Cachable>"
            f"<Endianess>LittleEndian</Endianess><Unit>{unit}</Unit></FloatReg>"
        )
    return nodes
