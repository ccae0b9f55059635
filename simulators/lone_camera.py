"""One camera as a program of its own: `python -m simulators camera --v4l2 /tmp/video0`, or `--gige 127.0.0.2`.

It looks at a dot plate that moves slowly to and fro, so that no picture is like another; or at recorded pictures.
"""

import argparse
import asyncio
import math
import sys
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import asdict
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators import parts
from simulators.clock import Clock
from simulators.genicam import SMALLEST_PACKET
from simulators.gige import LARGEST_PACKET, Exposure, GigeCameraServer
from simulators.optics import Optics
from simulators.place import Place
from simulators.render import render
from simulators.running import exact_loop, until_stopped
from simulators.v4l2 import Device, V4l2CameraServer
from simulators.v4l2.formats import FORMATS
from simulators.verb_socket import VerbSocket

Picture = NDArray[np.uint8]
Server = GigeCameraServer | V4l2CameraServer
FOURCCS = [known.fourcc.strip() for known in FORMATS.values()]
NOMINAL_EXPOSURE_US = 2000.0
SWING_MM, SWING_PERIOD_S = 2.0, 7.0
MIDDLE = Place(-4.8, -3.6)  # of the plate's dots to the axis


def main(arguments: list[str]) -> int:
    """Run until SIGINT or SIGTERM. Exit codes: 0 stopped, 1 cannot listen, 2 wrong arguments."""
    parser = _parser()
    given = parser.parse_args(arguments)
    show = _show(given, parser)
    try:
        with asyncio.Runner(loop_factory=exact_loop) as runner:
            runner.run(_serve(given, show))
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"simulated camera: {place}{error.strerror or error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cellctl simulate camera", description="A simulated industrial camera, for any client."
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--v4l2", type=Path, metavar="PATH", help="a file that takes a device node's calls (FUSE)")
    where.add_argument(
        "--gige", type=_loopback, metavar="IP", help="a GigE Vision camera at this address of 127.0.0.0/8"
    )
    parser.add_argument("--serial", default="SIM-CAM-1", help="serial number (default %(default)s)")
    parser.add_argument("--width", type=int, default=2592, help="of the sensor in px (default %(default)s)")
    parser.add_argument("--height", type=int, default=1944, help="of the sensor in px (default %(default)s)")
    parser.add_argument("--format", action="append", choices=FOURCCS, help="V4L2: only these (default: all)")
    parser.add_argument("--rate", type=float, default=15.0, metavar="HZ", help="V4L2: pictures per second")
    parser.add_argument("--no-trigger", action="store_true", help="V4L2: it runs free only, as USB cameras do")
    parser.add_argument("--name", default="", help="GigE: the name that its user gave it")
    parser.add_argument("--mtu", type=int, default=LARGEST_PACKET, metavar="BYTES", help="GigE: its largest packet")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="show these PNG or TIFF files in turn")
    parser.add_argument("--speed", type=float, default=1.0, help="world seconds per second (default 1: real time)")
    parser.add_argument("--person", type=Path, help="unix socket for faults (JSON lines)")
    return parser


def _loopback(text: str) -> str:
    """An address of this machine alone."""
    try:
        if IPv4Address(text).is_loopback:
            return text
    except AddressValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is no address of 127.0.0.0/8")


def _show(given: argparse.Namespace, parser: argparse.ArgumentParser) -> Callable[[Exposure], Picture]:
    """What it sees; a wrong argument ends the program."""
    size = given.width, given.height
    if not SMALLEST_PACKET <= given.mtu <= LARGEST_PACKET:
        parser.error(f"--mtu must be from {SMALLEST_PACKET} to {LARGEST_PACKET}")
    if min(size) < 16 or size[0] % 4 or size[1] % 2 or max(size) > 20000:
        parser.error("--width must be a multiple of 4, --height of 2, both from 16 to 20000")
    if given.pictures is None:
        return Plate(size)
    paths = sorted(path for path in given.pictures.glob("*") if path.suffix.lower() in (".png", ".tif", ".tiff"))
    if not paths:
        parser.error(f"--pictures: {given.pictures} has no PNG or TIFF file")
    return Album(paths, size)


class Plate:
    """A dot plate that swings to and fro in front of the camera."""

    def __init__(self, size: tuple[int, int]) -> None:
        self._optics = Optics.aimed((0.0, 0.0), looks="down", width=size[0], height=size[1])
        self._rng = np.random.default_rng(1)
        self._shapes = parts.dot_plate()

    def __call__(self, exposure: Exposure) -> Picture:
        """The asked part of the sensor in the middle of the exposure."""
        at_s = exposure.start_world_s + exposure.exposure_us * 0.5e-6
        swing_mm = SWING_MM * math.sin(math.tau * at_s / SWING_PERIOD_S)
        light = exposure.exposure_us / NOMINAL_EXPOSURE_US * 10 ** (exposure.gain_db / 20)
        scene = parts.scene((self._shapes, Place(swing_mm, 0.0) @ MIDDLE))
        return _part(render(scene, self._optics, self._rng, exposure=light), exposure)


class Album:
    """Recorded pictures, one after the other; smaller ones lie on black."""

    def __init__(self, paths: list[Path], size: tuple[int, int]) -> None:
        self._paths, self._size, self._number = paths, size, 0

    def __call__(self, exposure: Exposure) -> Picture:
        """The asked part of the next one."""
        path = self._paths[self._number % len(self._paths)]
        self._number += 1
        read = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if read is None:
            raise ValueError(f"{path} is no picture")
        width, height = self._size
        sensor = np.zeros((height, width), np.uint8)
        shown = np.asarray(read[:height, :width], np.uint8)
        sensor[: shown.shape[0], : shown.shape[1]] = shown
        return _part(sensor, exposure)


def _part(sensor: Picture, exposure: Exposure) -> Picture:
    top, left = exposure.offset_y, exposure.offset_x
    return sensor[top : top + exposure.height, left : left + exposure.width]


def _server(given: argparse.Namespace, show: Callable[[Exposure], Picture]) -> Server:
    clock, size = Clock(given.speed), (given.width, given.height)
    if given.gige is not None:
        options = {"name": given.name, "largest_packet": given.mtu}
        return GigeCameraServer(given.gige, given.serial, show, clock, sensor=size, **options)
    formats = [one.ljust(4) for one in given.format or ()]
    triggers = not given.no_trigger
    device = Device(given.serial, size, formats=formats, triggers=triggers, rate_hz=given.rate)
    return V4l2CameraServer(device, show, clock, path=given.v4l2.absolute())


async def _serve(given: argparse.Namespace, show: Callable[[Exposure], Picture]) -> None:
    once = Exposure(0.0, NOMINAL_EXPOSURE_US, 0.0, 0, 0, given.width, given.height)
    await asyncio.to_thread(show, once)  # the first picture takes long
    async with AsyncExitStack() as stack:
        server = _server(given, show)
        await stack.enter_async_context(server)
        if given.person is not None:
            person = VerbSocket(_verbs(server), given.person)
            await person.start()
            stack.push_async_callback(person.close)
        _print_where(given)
        await until_stopped()


def _verbs(server: Server) -> dict[str, Any]:
    def inject(fault: str, **params: object) -> None:
        server.inject(fault, **params)

    def state() -> dict[str, Any]:
        return asdict(server.counts)

    return {"inject": inject, "state": state}


def _print_where(given: argparse.Namespace) -> None:
    size = f"{given.width} x {given.height} px"
    if given.gige is not None:
        print(f"camera    GigE Vision at {given.gige}, serial {given.serial}, {size}")
        print(f"try       arv-tool-0.8 -a {given.gige} values      (any GigE Vision client on this machine)")
    else:
        print(f"camera    V4L2 at {given.v4l2}, serial {given.serial}, {size}")
        print(f"try       ffplay -f v4l2 -i {given.v4l2}      (any client that takes a file's path)")
    if given.person is not None:
        fault = "mute" if given.gige is not None else "unplug"
        print(f'person    {given.person}      {{"do": "inject", "fault": "{fault}"}}')
    print(f"world     speed {given.speed:g}; stop with Ctrl-C", flush=True)
