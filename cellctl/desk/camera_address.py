"""`cellctl camera set-address`: bring a camera to an address of this computer's network."""

import json
from ipaddress import IPv4Address, IPv4Interface
from typing import NamedTuple

import click

from cellctl.desk.commands import run_loop
from drivers.gige_address import force_address
from drivers.gige_discovery import Sighting, discover
from drivers.network import Nic, nics


class Order(NamedTuple):
    """What the command line asks for."""

    serial: str
    address: str
    as_json: bool


def set_address(order: Order) -> int:
    """Do it and say where the camera answers. Raises ClickException, DeviceError."""
    now = run_loop(_set(order))
    address = str(now.camera.address)
    if order.as_json:
        click.echo(json.dumps({"serial": now.camera.serial, "address": address, "until": "it is switched off"}))
    else:
        click.echo(
            f"camera {order.serial} answers at {address} until it is switched off; to keep it:\n"
            f"    arv-tool-0.8 -a {address} network mode=PersistentIP\n"
            f"    arv-tool-0.8 -a {address} network ip={address} mask={now.camera.interface.netmask} gateway=0.0.0.0"
        )
    return 0


async def _set(order: Order) -> Sighting:
    sightings = await discover()
    seen, nic = _found(sightings, order.serial)
    address = _wanted(order.address, nic)
    taken = next((each.camera for each in sightings if each.camera.address == address), None)
    if taken is not None and taken.serial != order.serial:
        raise click.ClickException(f"{address} is the address of camera {taken.serial}")
    return await force_address(seen, nic, IPv4Interface(f"{address}/{nic.interface.netmask}"))


def _found(sightings: list[Sighting], serial: str) -> tuple[Sighting, Nic]:
    for sighting in sightings:
        if sighting.camera.serial == serial and sighting.nic is not None:
            return sighting, sighting.nic
    known = ", ".join(sighting.camera.serial for sighting in sightings) or "none"
    raise click.ClickException(f"no camera {serial} answers on any network of this computer (there: {known})")


def _wanted(text: str, nic: Nic) -> IPv4Address:
    """The address, if it is one for a device on this card's network."""
    try:
        address = IPv4Address(text)
    except ValueError:
        raise click.ClickException(f"{text}: must be an IPv4 address such as 192.168.10.31") from None
    network = nic.interface.network
    if address not in network:
        raise click.ClickException(f"{address} is not in {network}, the network of {nic.name}, by which it was heard")
    if address in (network.network_address, network.broadcast_address) or address in {n.interface.ip for n in nics()}:
        raise click.ClickException(f"{address} is no address that a camera can have: take another one of {network}")
    return address
