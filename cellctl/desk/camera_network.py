"""The network between a GigE Vision camera and this computer, judged. drivers/CAMERAS.md explains each topic."""

from collections.abc import Iterator
from ipaddress import IPv4Address
from typing import NamedTuple

from drivers.network import Nic, Receiving

MIB = 1024 * 1024
LOSES_BYTES, GOOD_BYTES = 1 * MIB, 16 * MIB
GOOD_BACKLOG = 4096
GOOD_MBPS = 1000
PLAIN_MTU, JUMBO_MTU = 1500, 8000
SYSCTL = "`sysctl -w {key}={value}`, for good by deploy/90-cellctl.sysctl.conf"


class Finding(NamedTuple):
    """One line. `topic` is the row of drivers/CAMERAS.md; `ok` None: it works, and could be better."""

    camera: str
    topic: str
    ok: bool | None
    text: str


def network_findings(camera: str, address: IPv4Address, nic: Nic | None) -> Iterator[Finding]:
    """The way to the camera: network, link, packet size of the card."""
    if nic is None:
        yield Finding(camera, "network", False, f"there is no way to {address}: give a card an address in its network")
        return
    card = f"{nic.name} {nic.interface}"
    if nic.interface.is_loopback:
        yield Finding(camera, "network", True, f"{address} is on this computer")
        return
    if address not in nic.interface.network:
        text = f"{address} is in no network of this computer, the way to it is over a router by {card}"
        yield Finding(camera, "network", False, f"{text}: camera and card need addresses of one network")
        return
    yield Finding(camera, "network", True, f"{address} by {card}")
    yield _link(camera, nic)
    if nic.mtu_bytes is not None:
        yield _mtu(camera, nic.name, nic.mtu_bytes)


def _link(camera: str, nic: Nic) -> Finding:
    if nic.link == "down":
        return Finding(camera, "link", False, f"{nic.name} has no link: check cable, switch and the camera's power")
    if nic.link_mbps is None:
        return Finding(camera, "link", None, f"{nic.name} does not say how fast it is")
    if nic.link_mbps < GOOD_MBPS:
        text = f"{nic.name} runs at {nic.link_mbps} Mb/s: use a cable of category 5e or better, all eight wires"
        return Finding(camera, "link", False, text)
    return Finding(camera, "link", True, f"{nic.name} runs at {nic.link_mbps} Mb/s")


def _mtu(camera: str, card: str, mtu_bytes: int) -> Finding:
    if mtu_bytes < PLAIN_MTU:
        text = f"{card} takes packets of {mtu_bytes} bytes only: `ip link set {card} mtu 9000`"
        return Finding(camera, "mtu", False, text)
    if mtu_bytes < JUMBO_MTU:
        text = f"{card} takes packets of {mtu_bytes} bytes; 9000 cost less time: `ip link set {card} mtu 9000`"
        return Finding(camera, "mtu", None, text)
    return Finding(camera, "mtu", True, f"{card} takes packets of {mtu_bytes} bytes")


def kernel_findings(limits: Receiving) -> Iterator[Finding]:
    """What the kernel keeps for a receiver that is a moment late."""
    buffer_bytes, backlog = limits
    if buffer_bytes is not None:
        good = True if buffer_bytes >= GOOD_BYTES else None if buffer_bytes >= LOSES_BYTES else False
        remedy = "" if good else ": " + SYSCTL.format(key="net.core.rmem_max", value=33554432)
        yield Finding("computer", "buffer", good, f"rmem_max is {buffer_bytes / MIB:.1f} MiB{remedy}")
    if backlog is not None:
        enough = backlog >= GOOD_BACKLOG
        remedy = "" if enough else ": " + SYSCTL.format(key="net.core.netdev_max_backlog", value=8192)
        yield Finding("computer", "backlog", True if enough else None, f"{backlog} packets{remedy}")


def shared_findings(cards: dict[str, Nic | None]) -> Iterator[Finding]:
    """Cameras that share a card share its gigabit."""
    names = [nic.name for nic in cards.values() if nic is not None and not nic.interface.is_loopback]
    shared = sorted({name for name in names if names.count(name) > 1})
    for name in shared:
        text = (
            f"both cameras come by {name}: give each its own card, or let both wait between packets "
            "(packet delay, GevSCPD) so that together they fill the link"
        )
        yield Finding("computer", "shared", None, text)


def packet_finding(camera: str, packet_bytes: int, nic: Nic | None) -> Finding:
    """The packets that camera, switches and card agreed on, against what the card could take."""
    mtu_bytes = nic.mtu_bytes if nic is not None else None
    if mtu_bytes is None or mtu_bytes < JUMBO_MTU or packet_bytes >= JUMBO_MTU:
        return Finding(camera, "packets", True, f"{packet_bytes} bytes each")
    text = f"{packet_bytes} bytes each, though the card takes {mtu_bytes}: a switch or the camera does not"
    return Finding(camera, "packets", None, text)
