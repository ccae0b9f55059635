"""Another address for a GigE Vision camera, also for one that can be reached by broadcast only ("force IP")."""

import asyncio
import secrets
from contextlib import ExitStack
from ipaddress import IPv4Interface

from drivers import gvcp
from drivers.errors import NoAnswer
from drivers.gige_discovery import EVERYBODY, Sighting, discover, listen
from drivers.network import Nic

TRIES = 3
LOOK_S = 0.6  # a camera restarts its network meanwhile


async def force_address(seen: Sighting, nic: Nic, interface: IPv4Interface) -> Sighting:
    """Have the camera take this address until it is switched off; returns it as it answers there.

    A camera that a program controls does not take it. Raises NoAnswer.
    """
    camera = seen.camera
    for _ in range(TRIES):
        await _order(nic, camera.mac, interface)
        for now in await discover(within_s=LOOK_S, addresses=[str(interface.ip)]):
            if (now.camera.mac, now.camera.address) == (camera.mac, interface.ip):
                return now
    name = f"camera {camera.serial}"
    raise NoAnswer(name, f"it does not answer at {interface.ip}: a camera that a program controls keeps its address")


async def _order(nic: Nic, mac: str, interface: IPv4Interface) -> None:
    with ExitStack() as ears:
        transport = await listen(ears, _nothing, nic)
        if transport is None:
            raise NoAnswer(nic.name, "the card went away")
        transport.sendto(gvcp.force_ip(1 + secrets.randbelow(0xFFFF), mac, interface), (EVERYBODY, gvcp.PORT))
        await asyncio.sleep(0)


def _nothing(_datagram: bytes) -> None:
    """What counts is where the camera answers afterwards."""
