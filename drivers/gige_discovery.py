"""Which GigE Vision cameras are there? Asked of all networks, also of cameras whose address fits into none of them."""

import asyncio
import secrets
import socket
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from ipaddress import IPv4Address
from typing import NamedTuple

from drivers import gvcp
from drivers.gvcp import Found
from drivers.network import Nic, nics

ASK_AGAIN_S = 0.15  # a lost question or answer must not hide a camera
MOST_FOUND = 256
EVERYBODY = "255.255.255.255"


class Sighting(NamedTuple):
    """A camera, and the card on whose network it was heard (None: it was asked at its address)."""

    camera: Found
    nic: Nic | None


class _Ear(asyncio.DatagramProtocol):
    def __init__(self, heard: Callable[[bytes], None]) -> None:
        self._heard = heard

    def datagram_received(self, data: bytes, addr: tuple[str | int, ...]) -> None:
        self._heard(data)


async def discover(*, within_s: float = 0.5, addresses: Sequence[str] = ()) -> list[Sighting]:
    """All cameras that answer a broadcast on any network, or a question at one of these addresses, by address."""
    number = 1 + secrets.randbelow(0xFFFF)
    found: dict[tuple[str, IPv4Address], Sighting] = {}

    def note(nic: Nic | None) -> Callable[[bytes], None]:
        def heard(datagram: bytes) -> None:
            camera = gvcp.answer(datagram, number)
            if camera is not None and len(found) < MOST_FOUND:
                key = camera.mac, camera.address
                found[key] = Sighting(camera, nic or (found[key].nic if key in found else None))

        return heard

    with ExitStack() as ears:
        cards: list[tuple[Nic | None, Sequence[str]]] = [(nic, (EVERYBODY,)) for nic in _one_per_card()]
        asked = [(await listen(ears, note(nic), nic), targets) for nic, targets in [*cards, (None, addresses)]]
        await _ask([(ear, targets) for ear, targets in asked if ear is not None], number, within_s)
    return sorted(found.values(), key=lambda sighting: sighting.camera.address)


def _one_per_card() -> list[Nic]:
    return list({nic.name: nic for nic in reversed(nics())}.values())


async def listen(ears: ExitStack, heard: Callable[[bytes], None], nic: Nic | None) -> asyncio.DatagramTransport | None:
    """A socket on one card; not bound to the card's address, or it would not hear an answer by broadcast.

    On loopback it is: there the kernel would take the address of another card for the sender's.
    """
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        ear.setblocking(False)
        if nic is not None:
            ear.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            ear.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, nic.name.encode() + b"\0")
        ear.bind((str(nic.interface.ip) if nic is not None and nic.interface.is_loopback else "", 0))
    except OSError:  # the card went away
        ear.close()
        return None
    transport, _protocol = await asyncio.get_running_loop().create_datagram_endpoint(lambda: _Ear(heard), sock=ear)
    ears.callback(transport.close)
    return transport


async def _ask(asked: Sequence[tuple[asyncio.DatagramTransport, Sequence[str]]], number: int, within_s: float) -> None:
    loop = asyncio.get_running_loop()
    until_s = loop.time() + within_s
    while (left_s := until_s - loop.time()) > 0:
        for transport, targets in asked:
            for target in targets:
                with suppress(OSError):  # no way there
                    transport.sendto(gvcp.question(number), (target, gvcp.PORT))
        await asyncio.sleep(min(ASK_AGAIN_S, left_s))


def where_instead(sightings: Sequence[Sighting], serial: str, address: str) -> str:
    """What to say when nothing answers at the address where a camera with this serial number should be."""
    seen = next((each for each in sightings if each.camera.serial == serial), None)
    other = next((each for each in sightings if str(each.camera.address) == address), None)
    if seen is None and other is None:
        return "no camera with this serial number answers on any network of this computer: check its power and cable"
    if seen is None and other is not None:
        return f"the camera that answers there has serial number {other.camera.serial!r}"
    assert seen is not None
    if str(seen.camera.address) == address:
        return f"it answers there now ({seen.camera.model}): it was busy or starting, try again"
    return f"the camera with this serial number answers at {_place(seen)}: {_remedy(seen, address)}"


def _place(seen: Sighting) -> str:
    card = f", heard on {seen.nic.name} ({seen.nic.interface.network})" if seen.nic is not None else ""
    return f"{seen.camera.address} (its network is {seen.camera.interface.network}{card})"


def _remedy(seen: Sighting, address: str) -> str:
    give = f"give it the fixed address {address} with its maker's tool (force IP, then persistent IP)"
    if seen.nic is None or seen.camera.address in seen.nic.interface.network:
        return f"{give}, or with `arv-tool-0.8 -a {seen.camera.address} network`, or correct the configured address"
    return f"it fits into no network of this computer: {give}"
