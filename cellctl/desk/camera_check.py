"""`cellctl camera check`: the cell's cameras and all that lies between them and this computer."""

import json
import os
import statistics
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing
from ipaddress import IPv4Address
from pathlib import Path
from typing import NamedTuple

import click

from cellctl.cameras import build_camera
from cellctl.config import CellConfig, load_config
from cellctl.config_camera import CameraConfig
from cellctl.desk.camera_link import camera_of
from cellctl.desk.camera_network import (
    Finding,
    kernel_findings,
    network_findings,
    packet_finding,
    shared_findings,
)
from cellctl.desk.commands import run_loop
from cellctl.desk.ownership import nobody_owns
from drivers.camera import Camera
from drivers.errors import DeviceError, FrameLost
from drivers.gige_discovery import Sighting, discover, where_instead
from drivers.network import Nic, nic_towards, nics, receiving

MARK = {True: "ok     ", False: "FAILED ", None: "note   "}
GRAB_WITHIN_S = 2.0
PROGRESS_S = 2.0


class Order(NamedTuple):
    """What the command line asks for."""

    config: Path
    numbers: tuple[int, ...]
    pictures: int
    as_json: bool


class Subject(NamedTuple):
    """A camera of the cell and the card that leads to it."""

    name: str
    wanted: CameraConfig
    nic: Nic | None


def check_cameras(order: Order) -> int:
    """Print each finding as soon as it is known; 1 when one of them loses pictures. Raises SettingsError."""
    config = load_config(order.config)
    return 1 if run_loop(_told(config, order)) else 0


async def _told(config: CellConfig, order: Order) -> bool:
    failed = False
    async with aclosing(_findings(config, order)) as findings:
        async for finding in findings:
            failed = failed or finding.ok is False
            click.echo(json.dumps(finding._asdict()) if order.as_json else _line(finding))
    return failed


def _line(finding: Finding) -> str:
    return f"{MARK[finding.ok]}{finding.camera:<9} {finding.topic:<9} {finding.text}"


async def _findings(config: CellConfig, order: Order) -> AsyncGenerator[Finding, None]:
    subjects = [_subject(config, number) for number in order.numbers]
    on_the_net = [subject for subject in subjects if subject.wanted.driver == "gige"]
    for finding in _of_computer(on_the_net):
        yield finding
    sightings = await discover(addresses=[subject.wanted.address for subject in on_the_net]) if on_the_net else []
    owned = await _why_owned(config)
    for subject in subjects:
        there = True
        for finding in _of_way(subject, sightings):
            there = there and not (finding.topic in ("camera", "device") and finding.ok is False)
            yield finding
        if not there:
            continue
        if owned and subject.wanted.driver != "files":
            yield Finding(subject.name, "picture", None, f"no trial pictures: {owned}")
        elif order.pictures:
            async for finding in _of_pictures(subject, order.pictures):
                yield finding


def _subject(config: CellConfig, number: int) -> Subject:
    wanted = camera_of(config, number)
    nic = nic_towards(IPv4Address(wanted.address), nics()) if wanted.driver == "gige" else None
    return Subject(f"camera {number}", wanted, nic)


def _of_computer(on_the_net: list[Subject]) -> Iterator[Finding]:
    if on_the_net:
        yield from kernel_findings(receiving())
        yield from shared_findings({subject.name: subject.nic for subject in on_the_net})


def _of_way(subject: Subject, sightings: list[Sighting]) -> Iterator[Finding]:
    """What leads to the camera."""
    if subject.wanted.driver == "gige":
        yield from _of_network(subject, sightings)
    elif subject.wanted.driver == "v4l2":
        yield _of_node(subject)


def _of_network(subject: Subject, sightings: list[Sighting]) -> Iterator[Finding]:
    wanted = subject.wanted
    yield from network_findings(subject.name, IPv4Address(wanted.address), subject.nic)
    here = [each.camera for each in sightings if str(each.camera.address) == wanted.address]
    if here and here[0].serial == wanted.serial:
        text = f"{here[0].vendor} {here[0].model}, serial {wanted.serial}, MAC {here[0].mac}"
        yield Finding(subject.name, "camera", True, text)
    else:
        advice = where_instead(sightings, wanted.serial, wanted.address)
        text = f"camera {wanted.serial} is expected at {wanted.address}; {advice}"
        if any(each.camera.serial == wanted.serial and each.nic is not None for each in sightings):
            text += f": `cellctl camera set-address {wanted.serial} {wanted.address}`"
        yield Finding(subject.name, "camera", False, text)


def _of_node(subject: Subject) -> Finding:
    path = subject.wanted.address
    if not os.path.exists(path):
        return Finding(subject.name, "device", False, f"there is no {path}: is the camera plugged in? `ls /dev/video*`")
    if not os.access(path, os.R_OK | os.W_OK):
        text = f"{path} may not be opened by this user: add the user to the group video, or see deploy/99-cellctl.rules"
        return Finding(subject.name, "device", False, text)
    return Finding(subject.name, "device", True, path)


async def _why_owned(config: CellConfig) -> str:
    try:
        await nobody_owns(config, "the cameras")
    except click.ClickException as owned:
        return owned.message
    return ""


async def _of_pictures(subject: Subject, count: int) -> AsyncGenerator[Finding, None]:
    camera = build_camera(subject.name, subject.wanted)
    try:
        await camera.open()
        health = await camera.health()
        if health.packet_bytes is not None:
            yield packet_finding(subject.name, health.packet_bytes, subject.nic)
        if health.temperature_c is not None:
            yield Finding(subject.name, "warmth", True, f"{health.temperature_c:.1f} C")
        yield await _trial(subject.name, camera, count)
    except DeviceError as error:
        yield Finding(subject.name, "picture", False, error.detail)
    finally:
        await camera.close()


async def _trial(name: str, camera: Camera, count: int) -> Finding:
    """So many pictures; one that is lost is counted. Raises DeviceError when none comes any more."""
    took_ms, lost, told_s = [], 0, time.monotonic()
    for number in range(count):
        began_s = time.monotonic()
        if began_s - told_s > PROGRESS_S:
            click.echo(f"{name}: {number} of {count} pictures", err=True)
            told_s = began_s
        try:
            await camera.grab(within_s=GRAB_WITHIN_S)
        except FrameLost:
            lost += 1
            continue
        took_ms.append((time.monotonic() - began_s) * 1e3)
    resent = camera.counters.packets_resent
    median = f"median {statistics.median(took_ms):.1f} ms" if took_ms else "none whole"
    text = f"{len(took_ms)} of {count} whole, {median} from trigger to picture, {resent} packets sent again"
    if lost:
        return Finding(name, "picture", False, f"{text}: see the findings above, then cables and switch")
    return Finding(name, "picture", None if resent else True, text)
