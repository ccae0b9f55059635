"""The simulated GigE Vision camera: who may do what, power cycles, networks that lose, and datagrams that are wrong."""

import asyncio
import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators import gvcp
from simulators.clock import Clock
from simulators.gige import GigeCameraServer
from tests.gige_client import AT, DENIED, OK, SENSOR, Client, another, fresh_ip, gradient, served

CONTROL, EXCLUSIVE, SWITCHOVER = 2, 1, 4
ACTION, RESEND = 0x100, 0x40
KEYS = {"ActionDeviceKey": 0xC0FFEE, "ActionGroupKey": 7, "ActionGroupMask": 0b0110}
INVALID_HEADER, NOT_IMPLEMENTED, BAD_ALIGNMENT = 0x800E, 0x8001, 0x8005


async def test_under_control_others_may_read_and_under_exclusive_access_they_may_not():
    async with served() as (_server, client), another(client.ip) as other:
        assert await client.write(AT["GevCCP"], CONTROL) == OK
        assert await other.read(AT["Width"]) == SENSOR[0]
        assert await client.write(AT["GevCCP"], EXCLUSIVE) == OK
        assert (await other.ask(0x80, struct.pack(">I", AT["Width"])))[0] == DENIED
        assert (await other.ask(0x84, struct.pack(">IHH", 0x200, 0, 512)))[0] == DENIED
        assert await other.read(AT["GevCCP"]) == EXCLUSIVE
        assert (await other.ask(0x02))[0] == OK  # it still says who it is
        assert await client.read(AT["Width"]) == SENSOR[0]


async def test_the_camera_tells_who_controls_it():
    async with served() as (_server, client), another(client.ip) as other:
        assert await client.write(AT["GevCCP"], CONTROL) == OK
        host, port = client.control.getsockname()
        assert await other.read(AT["GevPrimaryApplicationSocket"]) == port
        address = await other.read(AT["GevPrimaryApplicationIPAddress"])
        assert socket.inet_ntoa(struct.pack(">I", address)) == host
        await client.write(AT["GevCCP"], 0)
        assert await other.read(AT["GevPrimaryApplicationSocket"]) == 0


async def test_a_second_controller_takes_over_only_where_it_is_allowed_and_knows_the_key():
    async with served() as (server, client), another(client.ip) as other:
        await client.arm()
        assert await client.write(AT["GevPrimaryApplicationSwitchoverKey"], 0x1234) == OK
        assert await client.read(AT["GevPrimaryApplicationSwitchoverKey"]) == 0
        assert await other.write(AT["GevCCP"], 0x1234 << 16 | CONTROL) == DENIED  # not allowed yet
        assert await client.write(AT["GevCCP"], CONTROL | SWITCHOVER) == OK
        assert await other.write(AT["GevCCP"], 0x4321 << 16 | CONTROL) == DENIED
        assert await other.write(AT["GevCCP"], 0x1234 << 16 | CONTROL) == OK
        assert await client.write(AT["TriggerSoftware"], 1) == DENIED
        assert await other.write(AT["TriggerSoftware"], 1) == OK
        _leader, pixels = await client.picture()  # the stream goes on where it went
        assert np.array_equal(pixels, gradient_of_all())
        assert server.counts.controllers_refused == 2


def gradient_of_all() -> np.ndarray:
    v, u = np.mgrid[: SENSOR[1], : SENSOR[0]]
    return (u * 7 + v * 31).astype(np.uint8)


async def test_a_controller_elsewhere_and_a_camera_that_refuses_control():
    async with served() as (server, client):
        server.inject("other_controller")
        await client.write(AT["GevHeartbeatTimeout"], 500)
        assert await client.write(AT["GevCCP"], CONTROL) == DENIED
        server.inject("release_control")
        server.inject("refuse_control")
        assert await client.write(AT["GevCCP"], CONTROL) == DENIED
        server.inject("refuse_control", on=False)
        assert await client.write(AT["GevCCP"], CONTROL) == OK


async def test_after_a_reboot_the_camera_is_as_new_and_its_clock_and_numbers_begin_anew():
    async with served() as (server, client):
        await client.arm()
        await client.write(AT["ExposureNs"], 700_000)
        await client.write(AT["TriggerSoftware"], 1)
        await client.picture()
        server.inject("reboot", for_s=0.15)
        client.send(0x80, struct.pack(">I", AT["ExposureNs"]))
        with pytest.raises(TimeoutError):
            await client.receive(client.control, 0.1)
        await asyncio.sleep(0.1)
        assert await client.read(AT["ExposureNs"]) == 1_000_000
        assert await client.read(AT["GevCCP"]) == 0
        assert await client.write(AT["TriggerSoftware"], 1) == DENIED
        await client.arm()
        await client.write(AT["TriggerSoftware"], 1)
        leader, _pixels = await client.picture()
        assert (leader["block"], leader["high"]) == (1, 0)
        assert leader["low"] < 2_000_000_000


async def test_an_action_starts_all_cameras_that_are_meant_and_no_other():
    clock = Clock(50)
    async with served(clock=clock) as (first, one), served(clock=clock) as (second, two):
        for client, mask in ((one, 0b0110), (two, 0b1000)):
            await client.arm()
            for name, value in {**KEYS, "ActionGroupMask": mask, "TriggerSource": 2}.items():
                assert await client.write(AT[name], value) == OK
        for group_mask in (0b0010, 0b1000, 0b1010, 0b0001):
            datagram = struct.pack(">BBHHHIII", 0x42, 1, ACTION, 12, group_mask, 0xC0FFEE, 7, group_mask)
            for server in (first, second):
                server._on_broadcast(datagram, one.control.getsockname())
            await asyncio.sleep(0.01)
        assert (first.counts.triggers, second.counts.triggers) == (2, 2)
        status, _body = await two.ask(ACTION, struct.pack(">III", 0xC0FFEE, 7, 0b1000))
        assert status == OK
        two.send(ACTION, struct.pack(">III", 0xDECAF, 7, 0b1000))
        with pytest.raises(TimeoutError):
            await two.receive(two.control, 0.1)


async def test_a_test_pattern_takes_the_place_of_the_scene():
    async with served() as (_server, client):
        await client.arm()
        seen = []
        for number in (1, 2, 3, 4, 4, 0):
            assert await client.write(AT["TestPattern"], number) == OK
            await client.write(AT["TriggerSoftware"], 1)
            seen.append((await client.picture())[1])
        ramp = np.broadcast_to(np.arange(SENSOR[0]).astype(np.uint8), SENSOR[::-1])
        assert not seen[0].any()
        assert seen[1].min() == 255
        assert np.array_equal(seen[2], ramp)
        assert np.array_equal(np.roll(seen[3], -1, axis=1)[:, :-1], seen[4][:, :-1])
        assert np.array_equal(seen[5], gradient_of_all())
        assert await client.write(AT["TestPattern"], 5) == 0x8002


async def test_a_network_of_small_packets_swallows_larger_ones_without_a_word():
    async with served() as (server, client):
        await client.arm()
        server.inject("mtu", size_bytes=4000)
        await client.write(AT["GevSCPS"], 0x80000000 | 8_188)
        with pytest.raises(TimeoutError):
            await client.receive(client.stream, 0.1)
        await client.write(AT["GevSCPS"], 0x80000000 | 4_000)
        assert len(await client.receive(client.stream)) == 4_000 - 28
        await client.write(AT["GevSCPS"], 8_188)
        await client.write(AT["TriggerSoftware"], 1)
        kinds = [(await client.receive(client.stream))[4] for _ in range(2)]
        assert kinds == [1, 2]  # leader and trailer are small
        server.inject("mtu")
        await client.write(AT["TriggerSoftware"], 1)
        assert np.array_equal((await client.picture())[1], gradient_of_all())


async def test_on_a_slow_link_packets_are_spread_over_the_time_that_it_takes():
    async with served(speed=1) as (server, client):
        server.inject("link", mbps=10)
        await client.write(AT["GevCCP"], CONTROL)
        for name, value in {"Width": 320, "Height": 240}.items():
            await client.write(AT[name], value)
        await client.arm()
        await client.write(AT["TriggerSoftware"], 1)
        times_s = []
        while (packet := await client.receive(client.stream))[4] != 2:
            times_s += [time.monotonic()] if packet[4] == 3 else []
        wire_s = 320 * 240 * 8 / 10e6
        assert 0.8 * wire_s < times_s[-1] - times_s[0] < 2.5 * wire_s
        assert max(np.diff(times_s)) < wire_s / 2


async def test_packets_that_are_not_in_memory_any_more_are_refused_one_by_one():
    async with served() as (server, client):
        await client.arm()
        server.inject("resend_limit", packets=2)
        await client.write(AT["TriggerSoftware"], 1)
        leader, _pixels = await client.picture()
        client.send(RESEND, struct.pack(">HHII", 0, leader["block"], 3, 6), flags=0)
        answers = [await client.receive(client.stream) for _ in range(4)]
        refused = [int.from_bytes(a[5:8], "big") for a in answers if a[:2] == b"\x80\x0c"]
        given = [int.from_bytes(a[5:8], "big") for a in answers if a[:2] == b"\0\0"]
        assert (given, refused) == ([3, 4], [5, 6])
        assert server.counts.packets_resent == 2


async def test_only_the_four_newest_pictures_can_be_asked_for_again():
    async with served() as (_server, client):
        await client.arm()
        for _ in range(5):
            await client.write(AT["TriggerSoftware"], 1)
            await client.picture()
        for block, status in ((1, b"\x80\x0c"), (2, b"\0\0"), (5, b"\0\0")):
            client.send(RESEND, struct.pack(">HHII", 0, block, 3, 3), flags=0)
            answer = await client.receive(client.stream)
            assert (answer[:2], int.from_bytes(answer[2:4], "big")) == (status, block)


async def test_packets_are_sent_again_to_the_controller_only():
    async with served() as (server, client):
        await client.arm()
        await client.write(AT["TriggerSoftware"], 1)
        await client.picture()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind((fresh_ip(), 0))
            stranger.sendto(struct.pack(">BBHHHHHII", 0x42, 0, RESEND, 12, 9, 0, 1, 3, 3), (server.ip, 3956))
        with pytest.raises(TimeoutError):
            await client.receive(client.stream, 0.1)
        assert server.counts.packets_resent == 0


@pytest.mark.parametrize(
    ("command", "body", "status"),
    [
        (0x02, b"?", INVALID_HEADER),
        (0x80, b"", INVALID_HEADER),
        (0x80, b"\0\0\1", INVALID_HEADER),
        (0x80, struct.pack(">I", 0x10001), BAD_ALIGNMENT),
        (0x82, struct.pack(">I", 0x10000), INVALID_HEADER),
        (0x84, struct.pack(">IHH", 0x200, 0, 0), INVALID_HEADER),
        (0x84, struct.pack(">IHH", 0x200, 0, 540), INVALID_HEADER),
        (0x84, struct.pack(">IHH", 0x200, 0, 6), BAD_ALIGNMENT),
        (0x86, struct.pack(">IB", 0x10000, 1), INVALID_HEADER),
        (ACTION, bytes(11), INVALID_HEADER),
        (0x88, b"", NOT_IMPLEMENTED),
        (0xFFFE, b"", NOT_IMPLEMENTED),
        (0x03, b"", NOT_IMPLEMENTED),
        (0xC0, b"", NOT_IMPLEMENTED),  # events: the camera has no message channel and says so
    ],
)
async def test_a_command_that_breaks_the_standard_is_answered_by_the_standards_status(
    command: int, body: bytes, status: int
):
    async with served() as (_server, client):
        assert (await client.ask(command, body)) == (status, b"")
        assert await client.read(0x0900) == 0  # message channels


async def test_a_datagram_that_is_none_is_counted_and_not_answered():
    async with served() as (server, client):
        good = struct.pack(">BBHHHI", 0x42, 1, 0x80, 4, 5, AT["Width"])
        longest = struct.pack(">BBHHH", 0x42, 1, 0x80, 544, 5) + bytes(544)
        wrong = (good[:-1], good + b"\0", b"\x43" + good[1:], good[:6] + b"\0\0" + good[8:], b"", longest)
        for datagram in wrong:
            client.control.sendto(datagram, (server.ip, 3956))
        with pytest.raises(TimeoutError):
            await client.receive(client.control, 0.1)
        assert server.counts.malformed == len(wrong)


async def test_two_cameras_stream_at_once_and_keep_apart():
    clock = Clock(20)
    async with (
        GigeCameraServer(fresh_ip(), "SN1", gradient, clock, sensor=SENSOR) as first,
        GigeCameraServer(fresh_ip(), "SN2", lambda e: 255 - gradient(e), clock, sensor=SENSOR) as second,
    ):
        with Client(first.ip) as one, Client(second.ip) as two:
            for client in (one, two):
                await client.arm()
            for _ in range(5):
                for client in (one, two):
                    await client.write(AT["TriggerSoftware"], 1)
                assert np.array_equal((await one.picture())[1], gradient_of_all())
                assert np.array_equal((await two.picture())[1], 255 - gradient_of_all())


@given(st.binary(max_size=80))
def test_any_body_of_a_command_is_understood_or_refused(body: bytes):
    wanted = gvcp.resend(body)
    assert wanted is None or (len(body) == 12 and wanted.block > 0 and 0 <= wanted.first <= wanted.last < 1 << 24)
    action = gvcp.action(body)
    assert (action is not None) == (len(body) == 12)
    forced = gvcp.forced(body)
    assert (forced is not None) == (len(body) == 56)
