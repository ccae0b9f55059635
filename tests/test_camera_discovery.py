"""Cameras that are looked for: who answers, where, and what to say when it is the wrong place."""

import asyncio
import struct
from ipaddress import IPv4Interface

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import gvcp, network
from drivers.errors import LinkLost
from drivers.gige import GigeCamera
from drivers.gige_discovery import Sighting, discover, where_instead
from drivers.gvcp import Found
from drivers.network import Nic, nic_towards, nics, receiving
from simulators import gvcp as camera_side
from tests.gige_rig import fresh_ip, rig, setup

TEXT = st.text(st.characters(codec="ascii", exclude_categories=["C"]), max_size=15).map(str.strip)
CARD = Nic("eth1", IPv4Interface("192.168.10.5/24"), 9000, 1000, "up")


def seen(address: str, serial: str = "SN1", nic: Nic | None = CARD) -> Sighting:
    return Sighting(Found(IPv4Interface(address), "00:11:22:33:44:55", "Maker", "Model", "1", serial, ""), nic)


async def test_a_camera_is_found_by_asking_everybody():
    async with rig() as r:
        here = [each for each in await discover() if str(each.camera.address) == r.server.ip]
    (found,) = here
    assert (found.camera.vendor, found.camera.model, found.camera.serial) == ("Cellctl", "CellSim", "SN1")
    assert found.camera.interface.network == IPv4Interface("127.0.0.1/8").network
    assert found.nic is not None
    assert found.nic.name == "lo"


async def test_a_camera_is_found_by_its_address_and_one_that_is_silent_is_not():
    async with rig() as r:
        assert r.server.ip in {str(each.camera.address) for each in await discover(addresses=[r.server.ip])}
        r.server.inject("mute")
        silent = await discover(addresses=[r.server.ip], within_s=0.2)
        assert r.server.ip not in {str(each.camera.address) for each in silent}
        r.server.inject("mute", on=False)


@given(st.binary(max_size=300), st.integers(1, 0xFFFF))
@settings(max_examples=40, deadline=None)
def test_whatever_answers_is_a_camera_or_nothing(datagram: bytes, number: int):
    assert gvcp.answer(datagram, number) is None or len(datagram) >= 256


@given(st.binary(min_size=248, max_size=248), st.integers(1, 0xFFFF))
@settings(max_examples=40, deadline=None)
def test_damaged_answers_never_reach_a_terminal_as_they_are(body: bytes, number: int):
    found = gvcp.answer(struct.pack(">HHHH", 0, 3, 248, number) + body, number)
    for text in [] if found is None else [found.vendor, found.model, found.version, found.serial, found.user_name]:
        assert text.isprintable()


@given(TEXT, TEXT, st.ip_addresses(v=4), st.integers(0, 32))
@settings(max_examples=40, deadline=None)
def test_an_answer_says_what_the_camera_is(model: str, serial: str, address, prefix: int):
    interface = IPv4Interface(f"{address}/{prefix}")
    body = bytearray(248)
    body[10:16] = bytes.fromhex("001122334455")
    body[36:40], body[52:56] = address.packed, interface.netmask.packed
    body[104 : 104 + len(model)], body[216 : 216 + len(serial)] = model.encode(), serial.encode()
    found = gvcp.answer(struct.pack(">HHHH", 0, 3, 248, 7) + body, 7)
    assert found is not None
    assert (found.model, found.serial, found.mac) == (model, serial, "00:11:22:33:44:55")
    assert found.address == address
    assert found.interface.network == (interface.network if prefix else IPv4Interface(f"{address}/32").network)
    assert gvcp.answer(struct.pack(">HHHH", 0, 3, 248, 8) + body, 7) is None  # of another question
    assert gvcp.answer(struct.pack(">HHHH", 0x8006, 3, 248, 7) + body, 7) is None  # a refusal


@given(st.binary(min_size=6, max_size=6), st.ip_addresses(v=4), st.integers(0, 32), st.integers(1, 0xFFFF))
@settings(max_examples=40, deadline=None)
def test_an_order_to_take_an_address_is_understood_as_it_is_meant(mac: bytes, address, prefix: int, number: int):
    interface = IPv4Interface(f"{address}/{prefix}")
    request = camera_side.decode(gvcp.force_ip(number, mac.hex(":"), interface))
    assert request is not None
    assert (request.command, request.number, len(request.body)) == (0x0004, number, 56)
    assert camera_side.forced(request.body) == (mac, str(address), int(interface.netmask))


@given(st.binary(max_size=80))
@settings(max_examples=40, deadline=None)
def test_an_order_of_another_length_moves_no_camera(body: bytes):
    assert (camera_side.forced(body) is None) is (len(body) != 56)


@pytest.mark.parametrize(
    ("sightings", "says"),
    [
        ([], "no camera with this serial number answers on any network of this computer"),
        ([seen("192.168.10.31/24", "SN9")], "the camera that answers there has serial number 'SN9'"),
        ([seen("192.168.10.31/24")], "it answers there now (Model)"),
        ([seen("192.168.10.77/24")], "answers at 192.168.10.77 (its network is 192.168.10.0/24, heard on eth1"),
        ([seen("169.254.3.4/16")], "fits into no network of this computer: give it the fixed address 192.168.10.31"),
    ],
)
def test_a_camera_at_another_place_gets_advice(sightings: list[Sighting], says: str):
    assert says in where_instead(sightings, "SN1", "192.168.10.31")


async def test_opening_a_camera_that_is_elsewhere_says_where():
    async with rig() as r:
        camera = GigeCamera("camera 1", fresh_ip(), setup())
        r.server.registers._memory[216:232] = b"SN-ELSEWHERE".ljust(16, b"\0")
        camera = GigeCamera("camera 1", fresh_ip(), setup(serial="SN-ELSEWHERE"))
        with pytest.raises(LinkLost, match=f"the camera with this serial number answers at {r.server.ip}"):
            await camera.open()
        await camera.close()


def test_the_loopback_card_is_known_and_is_the_way_to_its_network():
    known = nics()
    lo = next(nic for nic in known if nic.name == "lo")
    assert lo.interface == IPv4Interface("127.0.0.1/8")
    assert lo.mtu_bytes
    assert nic_towards(IPv4Interface("127.1.2.3").ip, known) == lo


def test_what_the_kernel_does_not_tell_is_unknown(monkeypatch: pytest.MonkeyPatch, tmp_path):
    assert (receiving().buffer_bytes or 0) > 0
    monkeypatch.setattr(network, "NET_CORE", tmp_path)
    assert receiving() == (None, None)
    (tmp_path / "rmem_max").write_text("no number\n")
    assert receiving().buffer_bytes is None


async def test_nothing_is_left_open_after_looking():
    before = asyncio.all_tasks()
    await discover(within_s=0.05)
    assert asyncio.all_tasks() == before
