"""The camera's benchmark, soak and fuzz in short: they run, they judge, and their rows say what they promise."""

import random
import struct

import pytest

from tests.benchmarks import bench_camera, fuzz_camera
from tests.benchmarks.bench_camera import table, wire_ms


def test_a_picture_takes_the_driver_little_longer_than_the_wire_and_one_memory():
    ip = bench_camera.fresh_ip(1)
    with bench_camera.camera_process(ip, 8188):
        row = bench_camera.in_a_process("grabs", [ip], 5)
    assert wire_ms(8188) < row["p50_ms"] < 3 * wire_ms(8188)
    assert row["p50_ms"] <= row["p99_ms"]
    assert 0.99 < row["copies"] < 1.1
    assert row["cpu_ms_per_frame"] < wire_ms(8188)
    assert "GigE driver  " in table({"GigE driver": row})


def test_the_wire_takes_its_time_for_pixels_and_headers():
    pixels = 2592 * 1944
    assert wire_ms(1500) == pytest.approx(4.0 + (pixels + 3442 * 74) * 8e-6, rel=1e-3)
    assert wire_ms(1500) > wire_ms(8188) > 4.0 + pixels * 8e-6


def test_in_a_long_run_memory_stays_as_it_is():
    ip = bench_camera.fresh_ip(2)
    with bench_camera.camera_process(ip, 8188, quick=True):
        row = bench_camera.in_a_process("memory", [ip], 400)
    assert row["frames"] == 400
    assert row["memory_grown_kib"] < 8 * 307  # not the 360 pictures that came


async def test_broken_datagrams_at_the_camera_are_answered_as_the_standard_says_or_not_at_all():
    row = await fuzz_camera.at_camera(10_000, seed=3)
    assert row["holds"]
    assert min(row["done"], row["refused"], row["malformed"]) > 100
    assert row["worst_ms"] < 1000


def test_broken_answers_of_cameras_are_nothing_or_a_camera_with_printable_names():
    row = fuzz_camera.at_driver(5_000, seed=3)
    assert row["holds"]
    assert row["nothing"] > 0
    assert row["a camera"] > 0


def test_an_answer_that_is_none_would_be_noticed():
    asked = struct.pack(">BBHHHI", 0x42, 1, 0x80, 4, 5, 0x10000)
    right = struct.pack(">HHHHI", 0, 0x81, 4, 5, 640)
    assert fuzz_camera.answered(asked, [right]) == "done"
    for wrong in (right[:-1], right + b"\0", right[:7] + b"\6" + right[8:], b"\x12" + right[1:]):
        assert fuzz_camera.answered(asked, [wrong]) == "wrong answer"
    assert fuzz_camera.answered(asked, [right, right]) == "wrong answer"


@pytest.mark.parametrize("kind", fuzz_camera.KINDS)
def test_stream_packets_of_each_kind_are_none_of_the_picture(kind: str):
    chance = random.Random(1)
    for _ in range(200):
        packet = fuzz_camera.stream_packet(chance, kind, 7, 212)
        ours = len(packet) >= 8 and packet[:2] == b"\0\0" and packet[2:4] == b"\0\7"
        assert not (ours and packet[4] == 3 and 0 < int.from_bytes(packet[5:8], "big") < 211)
