"""The simulated GigE Vision camera, judged by its datagrams and by other people's clients."""

import asyncio
import random
import socket
import struct
import time
import xml.etree.ElementTree as ET
import zipfile
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators import gvcp
from simulators.clock import Clock
from simulators.genicam import description, registers
from simulators.gige import Exposure, GigeCameraServer
from simulators.gige_registers import Identity, Registers
from simulators.gvcp import Request
from simulators.gvsp import Block, Picture, ReceiverBuffer, Sender
from tests.gige_client import AT, DENIED, OK, PENDING, SENSOR, Client, another, fresh_ip, gradient, served


async def test_discovery_tells_who_the_camera_is():
    async with served(name="left") as (server, client):
        status, body = await client.ask(0x02)
        assert (status, len(body)) == (OK, 0xF8)
        assert socket.inet_ntoa(body[0x24:0x28]) == server.ip
        texts = [body[at : at + 16].rstrip(b"\0").decode() for at in (0x48, 0xD8, 0xE8)]
        assert texts == ["Cellctl", "SN7", "left"]


async def test_two_cameras_both_hear_a_broadcast_and_other_networks_get_no_answer():
    async with served() as (first, client), served() as (second, _):
        client.control.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        datagram = struct.pack(">BBHHH", 0x42, 0x11, 0x02, 0, 99)
        heard = []
        for server in (first, second):
            server._on_broadcast(datagram, client.control.getsockname())
            heard.append(await client.receive(client.control))
        assert {socket.inet_ntoa(reply[8 + 0x24 : 8 + 0x28]) for reply in heard} == {first.ip, second.ip}
        first._on_broadcast(datagram, ("192.0.2.7", client.control.getsockname()[1]))
        with pytest.raises(TimeoutError):
            await client.receive(client.control, 0.1)


async def test_the_description_is_zipped_xml_that_names_every_register():
    async with served() as (_server, client):
        url = (await client.memory(0x200, 512)).rstrip(b"\0").decode()
        _name, address, length = url.removeprefix("Local:").split(";")
        archive = b""
        while len(archive) < int(length, 16):
            archive += await client.memory(int(address, 16) + len(archive), 512)
        with zipfile.ZipFile(BytesIO(archive[: int(length, 16)])) as file:
            root = ET.fromstring(file.read(file.namelist()[0]))
        space = "{http://www.genicam.org/GenApi/Version_1_1}"
        names = {node.get("Name") for node in root.iter() if node.get("Name")}
        links = {f"{space}{kind}" for kind in ("pValue", "pFeature", "pPort")}
        used = {leaf.text for leaf in root.iter() if leaf.tag in links}
        assert used <= names
        addresses = {int(leaf.text or "", 16) for leaf in root.iter(f"{space}Address")}
        assert {AT["Width"], AT["ExposureNs"], AT["TriggerSoftware"], AT["GevSCPS"]} <= addresses


def test_the_description_follows_the_sensor():
    root = ET.fromstring(description(registers((2592, 1944), 9000), (2592, 1944)))
    space = "{http://www.genicam.org/GenApi/Version_1_1}"
    width = next(node for node in root.iter(f"{space}Integer") if node.get("Name") == "Width")
    assert width.findtext(f"{space}Max") == "2592"


async def test_a_triggered_picture_carries_the_scene_and_the_cameras_time():
    async with served() as (server, client):
        await client.arm()
        before = time.monotonic_ns()
        assert await client.write(AT["TriggerSoftware"], 1) == OK
        leader, pixels = await client.picture()
        assert before < (leader["high"] << 32 | leader["low"]) < time.monotonic_ns()
        assert (leader["block"], leader["format"]) == (1, 0x01080001)
        assert np.array_equal(pixels, gradient(Exposure(0, 0, 0, 0, 0, *SENSOR)))
        assert server.counts.frames == 1


async def test_a_region_of_interest_is_rendered_and_sent_at_its_place():
    async with served() as (_server, client):
        assert await client.write(AT["GevCCP"], 2) == OK
        for name, value in {"Width": 320, "Height": 100, "OffsetX": 64, "OffsetY": 30}.items():
            assert await client.write(AT[name], value) == OK
        assert await client.write(AT["OffsetX"], 400) != OK  # 400 + 320 > 640
        assert await client.read(AT["PayloadSize"]) == 32_000
        await client.arm()
        assert await client.write(AT["Width"], 640) == 0x8007  # busy
        await client.write(AT["TriggerSoftware"], 1)
        leader, pixels = await client.picture()
        assert (leader["x"], leader["y"], pixels.shape) == (64, 30, (100, 320))
        assert np.array_equal(pixels, gradient(Exposure(0, 0, 0, 64, 30, 320, 100)))


async def test_exposure_and_gain_reach_the_scene():
    seen: list[Exposure] = []

    def scene(exposure: Exposure) -> np.ndarray:
        seen.append(exposure)
        return gradient(exposure)

    async with served(scene) as (_server, client):
        await client.write(AT["GevCCP"], 2)
        await client.write(AT["ExposureNs"], 850_500)
        await client.write(AT["GainMillidB"], 2_500)
        await client.arm()
        await client.write(AT["TriggerSoftware"], 1)
        await client.picture()
        assert (seen[0].exposure_us, seen[0].gain_db) == (850.5, 2.5)


async def test_without_a_trigger_the_camera_runs_free_in_world_time():
    async with served(speed=10) as (server, client):
        await client.write(AT["GevCCP"], 2)
        await client.write(AT["FramePeriodUs"], 200_000)
        await client.arm(trigger=False)
        began_s = time.monotonic()
        ticks = []
        for _ in range(6):
            leader, _pixels = await client.picture()
            ticks.append(leader["high"] << 32 | leader["low"])
        assert 0.09 < time.monotonic() - began_s < 1.0
        assert np.all(np.diff(ticks) > 10_000_000)  # 200 ms in a world ten times as fast
        assert await client.write(AT["AcquisitionStop"], 1) == OK
        await asyncio.sleep(0.05)
        frames = server.counts.frames
        await asyncio.sleep(0.1)
        assert server.counts.frames == frames


async def test_world_time_stands_while_a_slow_picture_is_made():
    clock = Clock(100)
    done_s: list[float] = []

    def slow(exposure: Exposure) -> np.ndarray:
        time.sleep(0.1)  # ten world seconds
        done_s.append(clock.now() - exposure.start_world_s)
        return gradient(exposure)

    async with served(slow, clock=clock) as (_server, client):
        await client.arm()
        start_s = clock.now()
        await client.write(AT["TriggerSoftware"], 1)
        await client.picture()
        # 1 ms exposure, 3 ms read-out, 2.5 ms on the wire, and what passes between the looks at the clock
        assert done_s[0] < 0.01
        assert clock.now() - start_s < 2.0


async def test_at_speed_one_a_picture_takes_as_long_as_on_a_gigabit_link():
    async with served(speed=1) as (_server, client):
        await client.write(AT["GevCCP"], 2)
        await client.write(AT["ExposureNs"], 20_000_000)
        await client.arm()
        began_s = time.monotonic()
        await client.write(AT["TriggerSoftware"], 1)
        await client.picture()
        assert time.monotonic() - began_s > 0.020 + 0.003 + 640 * 480 * 8 / 1e9


async def test_a_trigger_during_an_exposure_is_missed():
    async with served(speed=1) as (server, client):
        await client.write(AT["GevCCP"], 2)
        await client.write(AT["ExposureNs"], 50_000_000)
        await client.arm()
        for _ in range(3):
            await client.write(AT["TriggerSoftware"], 1)
        await client.picture()
        assert (server.counts.triggers, server.counts.triggers_missed) == (3, 2)


async def test_packets_can_be_asked_for_again_while_they_are_in_memory():
    async with served() as (server, client):
        await client.arm()
        await client.write(AT["TriggerSoftware"], 1)
        leader, pixels = await client.picture()
        ask = struct.pack(">HHII", 0, leader["block"], 3, 5)
        client.send(0x40, ask, flags=0)
        for number in (3, 4, 5):
            packet = await client.receive(client.stream)
            chunk = 1500 - 36
            assert int.from_bytes(packet[5:8], "big") == number
            assert packet[8:] == pixels.tobytes()[(number - 1) * chunk : number * chunk]
        client.send(0x40, struct.pack(">HHII", 0, 77, 3, 0xFFFFFF), flags=0)  # a block that never was
        assert (await client.receive(client.stream))[:2] == b"\x80\x0c"
        assert server.counts.packets_resent == 3


async def test_one_controller_at_a_time_and_no_writing_without_control():
    async with served() as (server, client), another(server.ip) as other:
        assert await other.write(AT["ExposureNs"], 900_000) == DENIED
        assert await client.write(AT["GevCCP"], 2) == OK
        assert await other.write(AT["GevCCP"], 2) == DENIED
        assert await other.read(AT["Width"]) == 640
        assert await other.write(AT["TriggerSoftware"], 1) == DENIED
        assert await client.write(AT["GevCCP"], 0) == OK
        assert await other.write(AT["GevCCP"], 2) == OK


async def test_a_controller_that_falls_silent_loses_control():
    async with served() as (_server, client), another(client.ip) as other:
        await client.write(AT["GevCCP"], 2)
        await client.write(AT["GevHeartbeatTimeout"], 500)
        async with asyncio.timeout(2.0):
            while await other.write(AT["GevCCP"], 2) != OK:  # a client has to ask
                await asyncio.sleep(0.05)


async def test_an_acknowledgement_lost_and_asked_again_triggers_once():
    async with served() as (server, client):
        await client.arm()
        for _ in range(3):
            status, _body = await client.ask(0x82, struct.pack(">II", AT["TriggerSoftware"], 1), number=777)
            assert status == OK
        assert server.counts.triggers == 1


async def test_a_pending_acknowledgement_announces_itself():
    async with served() as (server, client):
        server.inject("pending_ack", delay_ms=30)
        client.send(0x80, struct.pack(">I", AT["Width"]))
        first, second = await client.receive(client.control), await client.receive(client.control)
        assert struct.unpack_from(">HH", first) == (OK, PENDING)
        assert struct.unpack(">I", second[8:])[0] == 640


@pytest.mark.parametrize(
    ("address", "value", "status"),
    [
        (AT["Width"], 641, 0x8002),
        (AT["Width"], 639, 0x8002),
        (AT["PixelFormat"], 0x02180014, 0x8002),
        (AT["ExposureNs"], 1, 0x8002),
        (AT["SensorWidth"], 640, 0x8004),
        (0x0024, 1, 0x8004),
        (0x10002, 1, 0x8005),
        (0x70000000, 1, 0x8003),
    ],
)
async def test_a_value_that_a_register_does_not_take_is_refused(address: int, value: int, status: int):
    async with served() as (_server, client):
        await client.write(AT["GevCCP"], 2)
        before = await client.memory(0x10000, 256)
        assert await client.write(address, value) == status
        assert await client.memory(0x10000, 256) == before


async def test_a_packet_size_becomes_the_next_possible_one_and_test_packets_show_it():
    async with served() as (_server, client):
        await client.arm()
        await client.write(AT["GevSCPS"], 0x80000000 | 8_191)
        assert await client.read(AT["GevSCPS"]) == 8_188
        assert len(await client.receive(client.stream)) == 8_188 - 28


async def camera_that_fails(picture) -> tuple[GigeCameraServer, Clock]:
    """A camera, still open, whose first picture failed."""
    clock = Clock(50)
    server = GigeCameraServer(fresh_ip(), "SN7", picture, clock, sensor=SENSOR)
    await server.start()
    with Client(server.ip) as client:
        await client.arm()
        await client.write(AT["TriggerSoftware"], 1)
        await client.write(AT["TriggerSoftware"], 1)
        with pytest.raises(TimeoutError):
            await client.picture(within_s=0.2)
    return server, clock


async def test_an_error_while_rendering_is_raised_when_the_camera_is_closed():
    def broken(exposure: Exposure) -> np.ndarray:
        raise ArithmeticError("no light")

    server, clock = await camera_that_fails(broken)
    now_s = clock.now()
    await asyncio.sleep(0.02)
    assert clock.now() > now_s + 0.5  # a broken camera does not stop the world
    with pytest.raises(ArithmeticError, match="no light"):
        await server.close()


async def test_a_picture_of_the_wrong_shape_is_an_error():
    server, _clock = await camera_that_fails(lambda exposure: np.zeros((3, 3), np.uint8))
    with pytest.raises(ValueError, match=r"\(480, 640\) uint8"):
        await server.close()


async def test_a_taken_address_is_named():
    async with served() as (server, _client):
        second = GigeCameraServer(server.ip, "SN8", gradient, Clock(1), sensor=SENSOR)
        with pytest.raises(OSError, match=f"camera SN8 at {server.ip}:3956"):
            await second.start()


@pytest.mark.parametrize(
    ("fault", "params"),
    [
        ("hiccup", {}),
        ("drop_ratio", {}),
        ("drop_ratio", {"ratio": 1.5}),
        ("mute", {"loud": True}),
        ("release_control", {"on": 1}),
    ],
)
async def test_a_fault_that_a_camera_cannot_have_is_refused(fault: str, params: dict[str, object]):
    async with served() as (server, _client):
        with pytest.raises(ValueError, match=r"camera|ratio"):
            server.inject(fault, **params)


def random_datagram(rng: random.Random) -> bytes:
    body = rng.randbytes(rng.randrange(0, 24))
    if rng.random() < 0.3:
        return rng.randbytes(rng.randrange(0, 40))
    if rng.random() < 0.5:
        address = rng.choice([*AT.values(), 0x200, 0x80000, 0x80010, 0xFFFFFFFC, rng.randrange(1 << 32)])
        body = struct.pack(">I", address) + rng.choice([b"", body, rng.randbytes(4), b"\0\0\0\1", b"\0\0\x02\x18"])
    command = rng.choice([0x02, 0x40, 0x80, 0x82, 0x84, 0x86, 0x88, rng.randrange(1 << 16)])
    length = len(body) if rng.random() < 0.9 else rng.randrange(1 << 16)
    number = rng.randrange(1 << 16)
    return struct.pack(">BBHHH", 0x42, rng.randrange(256), command, length, number) + body


async def test_twenty_thousand_random_datagrams_do_no_harm():
    async with served() as (server, client), another(server.ip) as fresh:
        await client.arm()
        rng = random.Random(20261122)
        me = client.control.getsockname()
        for count in range(20_000):
            server._on_datagram(random_datagram(rng), me)
            server._on_broadcast(random_datagram(rng), me)
            if count % 500 == 0:
                await asyncio.sleep(0)
        server.inject("clear")
        server._control.release()
        assert await fresh.read(AT["SensorWidth"]) == 640
        await fresh.arm()


@given(st.binary(max_size=64))
def test_any_datagram_is_decoded_or_refused(datagram: bytes):
    request = gvcp.decode(datagram)
    if request is not None:
        assert request.body == datagram[8:]
        assert datagram[0] == 0x42
        for parse in (gvcp.reads, gvcp.writes):
            parse(request)
        gvcp.resend(request.body)


@given(
    st.sampled_from([0x80, 0x82, 0x84, 0x86]),
    st.lists(st.integers(0, 2**32 - 1), max_size=6),
    st.booleans(),
)
def test_any_access_is_answered_without_touching_what_is_read_only(command: int, words: list[int], busy: bool):
    memory = Registers(Identity("127.0.0.1", "SN7", ""), SENSOR, 16_000)
    fixed = memory.discovery()[:0xE8], memory["SensorWidth"]
    request = Request(command, True, 1, struct.pack(f">{len(words)}I", *words))
    if command in (0x80, 0x84):
        for address, length in gvcp.reads(request) or []:
            data = memory.read(address, length)
            assert isinstance(data, gvcp.Status) or len(data) == length
    else:
        for address, data in gvcp.writes(request) or []:
            memory.write(address, data, busy=busy)
    assert (memory.discovery()[:0xE8], memory["SensorWidth"]) == fixed


@given(
    st.integers(1, 40),
    st.integers(1, 60),
    st.integers(220, 1500),
    st.integers(0, 2**64 - 1),
)
def test_a_picture_of_any_size_is_whole_in_packets_of_any_size(height: int, width: int, packet: int, ticks: int):
    pixels = np.random.default_rng(width).integers(0, 256, (height, width), dtype=np.uint8)
    sender = Sender("127.0.0.1")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(1.0)
        target = receiver.getsockname()
        block = Block(7, Picture(pixels.reshape(-1), ticks, 0, 0, pixels.shape[1], height), packet, target)
        sender.send(block, block.order(), target)
        packets = [receiver.recv(2000) for _ in range(block.last + 1)]
    sender.close()
    assert max(len(each) for each in packets) <= packet - 28
    assert [int.from_bytes(each[5:8], "big") for each in packets] == list(range(block.last + 1))
    assert b"".join(each[8:] for each in packets[1:-1]) == pixels.tobytes()
    assert int.from_bytes(packets[0][12:20], "big") == ticks


def test_the_room_in_a_receivers_buffer_is_known_where_the_kernel_tells():
    buffer = ReceiverBuffer()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
    ):
        sender.bind(("127.0.0.1", 0))
        receiver.bind(("127.0.0.1", 0))
        ends = sender.getsockname(), receiver.getsockname()
        empty = buffer.room(*ends)
        if empty is None:
            pytest.skip("this kernel has no UDP socket diagnostics; the sender paces blindly here")
        assert empty[0] == empty[1] == receiver.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        sender.sendto(bytes(8000), ends[1])
        full = buffer.room(*ends)
        assert full is not None
        assert 8000 <= empty[0] - full[0] <= 32_000
    assert buffer.room(("127.0.0.1", 1), ("127.0.0.1", 1)) is None
    buffer.close()
    assert buffer.room(*ends) is None


def test_a_receiver_that_does_not_read_holds_the_sender_up_only_so_long():
    sender = Sender("127.0.0.1")
    pixels = np.zeros((1000, 1000), np.uint8)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        target = deaf.getsockname()
        block = Block(1, Picture(pixels.reshape(-1), 0, 0, 0, pixels.shape[1], 1000), 1500, target)
        began_s = time.monotonic()
        sender.send(block, block.order(), target)
        assert time.monotonic() - began_s < 0.5
    sender.close()


async def test_closing_a_busy_camera_leaves_nothing_behind():
    async with served(speed=1) as (_server, client):
        await client.arm(trigger=False)
        await client.picture()
    assert asyncio.all_tasks() == {asyncio.current_task()}
