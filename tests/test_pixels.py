"""Pixel formats, against a slow reference that reads bit by bit as the standards draw them."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.pixels import (
    BY_NAME,
    FORMATS,
    MONO8,
    MONO12,
    MONO12P,
    MONO12PACKED,
    MONO16,
    PixelError,
    PixelFormat,
    eight_bit,
    full_depth,
)
from simulators import gige_formats
from simulators.genicam import PIXEL_FORMATS

SIZES = st.tuples(st.integers(1, 40), st.integers(1, 12))


def slow(payload: bytes, name: str, count: int) -> Iterator[int]:
    """Grey levels one by one."""
    bits = int("".join(filter(str.isdigit, name)) or 8)
    stream = int.from_bytes(payload, "little")
    for n in range(count):
        if name == "YUYV":
            yield payload[2 * n]
        elif name == "Mono8":
            yield payload[n]
        elif name == "Y10P":
            group = payload[n // 4 * 5 : n // 4 * 5 + 5]
            yield group[n % 4] << 2 | group[4] >> 2 * (n % 4) & 3 if len(group) == 5 else -1
        elif name.endswith("Packed"):
            high, low = payload[n // 2 * 3 + 2 * (n % 2)], payload[n // 2 * 3 + 1] >> 4 * (n % 2)
            yield high << (bits - 8) | low & ((1 << bits - 8) - 1)
        elif name.endswith("p"):
            yield stream >> bits * n & ((1 << bits) - 1)
        else:
            yield payload[2 * n] | payload[2 * n + 1] << 8


def payload_of(pixel_format: PixelFormat, size: tuple[int, int], seed: int) -> np.ndarray:
    """Any bytes that the format allows."""
    payload = np.random.default_rng(seed).integers(0, 256, pixel_format.bytes_for(*size), dtype=np.uint8)
    if pixel_format.bits_on_the_wire == 16 and pixel_format.bits > 8:
        words = payload.view("<u2")
        words &= pixel_format.white
    return payload


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda each: each.name)
@given(size=SIZES, seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_every_format_is_unpacked_as_its_standard_draws_it(pixel_format: PixelFormat, size: tuple[int, int], seed: int):
    if pixel_format.name == "Y10P":
        size = 4 * size[0], size[1]  # MIPI lines are whole groups
    payload = payload_of(pixel_format, size, seed)
    expected = list(slow(payload.tobytes(), pixel_format.name, size[0] * size[1]))

    deep = full_depth(payload, pixel_format, *size)

    assert deep.shape == (size[1], size[0])
    assert deep.dtype == np.uint16
    assert deep.reshape(-1).tolist() == expected
    step = 1 << (pixel_format.bits - 8)
    rounded = [min((value + step // 2) // step, 255) for value in expected]
    assert eight_bit(payload, pixel_format, *size).reshape(-1).tolist() == rounded


@given(size=SIZES, seed=st.integers(0, 2**32), name=st.sampled_from(sorted(PIXEL_FORMATS)))
@settings(max_examples=40, deadline=None)
def test_what_the_simulated_sensor_packs_is_unpacked_again(size: tuple[int, int], seed: int, name: str):
    seen = np.random.default_rng(seed).integers(0, 1 << 16, size[::-1], dtype=np.uint16)
    pixel_format = BY_NAME[name]
    assert pixel_format.code == PIXEL_FORMATS[name]
    payload = gige_formats.pack(seen, PIXEL_FORMATS[name])
    assert np.array_equal(full_depth(payload, pixel_format, *size), seen >> (16 - pixel_format.bits))


@given(st.sampled_from(FORMATS), SIZES, st.integers(0, 400))
@settings(max_examples=40, deadline=None)
def test_too_many_or_too_few_bytes_are_refused(pixel_format: PixelFormat, size: tuple[int, int], count: int):
    if count == pixel_format.bytes_for(*size):
        return
    for unpack in (eight_bit, full_depth):
        with pytest.raises(PixelError, match=f"bytes of {size[0]} x {size[1]} {pixel_format.name}"):
            unpack(np.zeros(count, np.uint8), pixel_format, *size)


def test_a_mono8_picture_is_not_copied():
    payload = np.arange(12, dtype=np.uint8)
    assert np.shares_memory(eight_bit(payload, MONO8, 4, 3), payload)


def test_values_that_a_format_cannot_have_are_refused_with_the_largest():
    left_aligned = np.array([4095 << 4], "<u2").view(np.uint8)
    with pytest.raises(PixelError, match="values up to 65520, and Mono12 ends at 4095"):
        eight_bit(left_aligned, MONO12, 1, 1)


@pytest.mark.parametrize(
    ("pixel_format", "white"),
    [(MONO12, b"\xff\x0f"), (MONO16, b"\xff\xff"), (MONO12P, b"\xff\x0f"), (MONO12PACKED, b"\xff\x0f")],
)
def test_white_stays_white_and_black_stays_black(pixel_format: PixelFormat, white: bytes):
    payload = np.frombuffer(white, np.uint8)
    assert eight_bit(payload, pixel_format, 1, 1).item() == 255
    assert full_depth(payload, pixel_format, 1, 1).item() == pixel_format.white
    assert eight_bit(np.zeros(2, np.uint8), pixel_format, 1, 1).item() == 0


def test_names_and_codes_are_unique():
    codes = [each.code for each in FORMATS if each.code]
    assert len(set(codes)) == len(codes)
    assert len(BY_NAME) == len(FORMATS)
