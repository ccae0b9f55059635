"""A simulated cell on real ports: one world, and the protocol servers of PLC, robot and both cameras on it."""

import asyncio
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Literal, Protocol, Self

from simulators.eyes import Eye
from simulators.gige import GigeCameraServer
from simulators.plc import PlcServer
from simulators.plc_program import DELIVERED, PlcProgram
from simulators.robot import RobotController, Wiring
from simulators.v4l2 import Device, V4l2CameraServer
from simulators.world import World

VACUUM_SWITCH_KPA = -40.0
VIDEO_RATE_HZ = 5.0  # what USB 2 carries of five megapixels
CameraServer = GigeCameraServer | V4l2CameraServer


@dataclass(frozen=True)
class Addresses:
    """Where the devices listen. Port 0 = any free port; a camera's GVCP port is always 3956.

    A camera's is an IP address (GigE Vision), the absolute path of a file that stands for a device node (V4L2), or ""
    for a V4L2 camera that is opened from this process only.
    """

    plc_host: str = "127.0.0.1"
    plc_port: int = 5020
    robot_host: str = "127.0.0.1"
    robot_port: int = 10023
    camera_1: str = "127.0.0.2"
    camera_2: str = "127.0.0.3"
    video_triggers: bool = True  # V4L2 cameras can be triggered; most USB cameras cannot
    robot_serial_baud: int | None = None  # also on a serial line (a pseudo terminal), paced like this baud rate
    robot_dialect: Literal["rcx3", "rcx2"] = "rcx3"  # an RCX340, or an RCX240


class Server(Protocol):
    """A protocol simulator."""

    async def start(self) -> None:
        """Listen."""

    async def close(self) -> None:
        """Stop listening."""


def robot_wiring(world: World) -> Wiring:
    """The robot's own vacuum: valve at DO20, switch at DI20. A cell may use them instead of the PLC's."""
    return Wiring(
        inputs={(2, 0): lambda: world.vacuum_kpa() < VACUUM_SWITCH_KPA},
        outputs={(2, 0): partial(world.valve, by="robot")},
    )


def _camera(number: int, address: str, eye: Eye, world: World, *, triggers: bool) -> CameraServer:
    serial = f"SIM-CAM-{number}"
    if not address or address.startswith("/"):
        device = Device(serial, triggers=triggers, rate_hz=VIDEO_RATE_HZ)
        return V4l2CameraServer(device, eye, world.clock, path=Path(address) if address else None)
    return GigeCameraServer(address, serial, eye, world.clock, name=f"camera {number}")


class SimulatedCell:
    """All devices of one cell; an async context manager.

    `album` is a folder that gets every picture that is taken. `plc_program` is the Structured Text that the PLC
    executes; StError is raised when that is wrong.
    """

    def __init__(
        self, world: World, addresses: Addresses, album: Path | None = None, *, plc_program: Path = DELIVERED
    ) -> None:
        self.world = world
        self.plc = PlcServer(
            world,
            host=addresses.plc_host,
            port=addresses.plc_port,
            program=partial(PlcProgram, source=plc_program),
        )
        self.robot = RobotController(
            world,
            dialect=addresses.robot_dialect,
            host=addresses.robot_host,
            port=addresses.robot_port,
            serial_baud=addresses.robot_serial_baud,
            wiring=robot_wiring(world),
        )
        self._eyes = Eye(world, 1, album), Eye(world, 2, album)
        self.cameras: dict[int, CameraServer] = {
            number: _camera(number, address, eye, world, triggers=addresses.video_triggers)
            for number, (address, eye) in enumerate(
                zip((addresses.camera_1, addresses.camera_2), self._eyes, strict=True), 1
            )
        }
        for number, camera in self.cameras.items():
            world.register(f"camera_{number}", camera.inject)
        self._stack = AsyncExitStack()

    async def __aenter__(self) -> Self:
        """Open all ports, or none: an address that is taken raises OSError."""
        for eye in self._eyes:
            await asyncio.to_thread(eye.warm)
        async with AsyncExitStack() as stack:
            servers: list[Server] = [self.plc, self.robot, *self.cameras.values()]
            for server in servers:
                await server.start()
                stack.push_async_callback(server.close)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close all ports."""
        await self._stack.aclose()
