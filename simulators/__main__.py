"""A simulated cell for any client: `python -m simulators --product recipes/x85.toml`."""

import argparse
import asyncio
import selectors
import signal
import sys
from contextlib import suppress
from pathlib import Path

import cv2

from simulators.cell import Addresses, SimulatedCell
from simulators.person import Person
from simulators.product import load_product
from simulators.world import World


def main() -> int:
    """Run until SIGINT or SIGTERM."""
    options = _parser().parse_args()
    world = World(options.seed, load_product(options.product), speed=options.speed)
    cv2.setNumThreads(1)  # one thread per camera renders already
    sys.setswitchinterval(0.0005)  # and gives the interpreter back to the protocol servers
    try:
        with asyncio.Runner(loop_factory=_exact_loop) as runner:
            runner.run(_serve(world, _addresses(options), options.person))
    except OSError as error:
        print(f"simulated cell: cannot listen: {error.strerror or error}; is another one running?", file=sys.stderr)
        return 1
    return 0


def _exact_loop() -> asyncio.AbstractEventLoop:
    """A loop whose timers are not rounded to milliseconds, which are tenths of a second of a fast world."""
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cellctl simulate",
        description="A simulated cell: PLC (Modbus TCP), RCX340 robot (TCP), two GigE Vision cameras, one world.",
    )
    parser.add_argument("--product", type=Path, default=Path("recipes/x85.toml"), help="recipe file with the drawing")
    parser.add_argument("--seed", type=int, default=1, help="which cell: mounts, lenses, parts and scatter")
    parser.add_argument("--speed", type=float, default=1.0, help="world seconds per second (default 1: real time)")
    parser.add_argument("--plc", default="127.0.0.1:5020", metavar="HOST:PORT")
    parser.add_argument("--robot", default="127.0.0.1:10023", metavar="HOST:PORT")
    parser.add_argument("--robot-serial", type=int, metavar="BAUD", help="offer the robot on a pseudo terminal, too")
    parser.add_argument("--camera-1", default="127.0.0.2", metavar="IP")
    parser.add_argument("--camera-2", default="127.0.0.3", metavar="IP")
    parser.add_argument("--person", type=Path, help="unix socket for the person at the cell (JSON lines)")
    return parser


def _addresses(options: argparse.Namespace) -> Addresses:
    plc_host, plc_port = _host_port(options.plc)
    robot_host, robot_port = _host_port(options.robot)
    return Addresses(
        plc_host, plc_port, robot_host, robot_port, options.camera_1, options.camera_2, options.robot_serial
    )


def _host_port(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdecimal():
        raise SystemExit(f"{text!r} is not HOST:PORT")
    return host, int(port)


async def _serve(world: World, addresses: Addresses, person: Path | None) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    async with SimulatedCell(world, addresses) as cell:
        at_hand = Person(world, person) if person else None
        if at_hand:
            await at_hand.start()
        print(f"PLC       Modbus TCP    {addresses.plc_host}:{cell.plc.port}, unit 1")
        print(f"robot     RCX340        {addresses.robot_host}:{cell.robot.port}")
        if addresses.robot_serial_baud:
            print(f"robot     RCX340        serial:{cell.robot.tty}?baud={addresses.robot_serial_baud}")
        print(f"camera 1  GigE Vision   {addresses.camera_1} (SIM-CAM-1)")
        print(f"camera 2  GigE Vision   {addresses.camera_2} (SIM-CAM-2)")
        print(f"world     seed {world.seed}, speed {world.clock.speed:g}; stop with Ctrl-C", flush=True)
        with suppress(asyncio.CancelledError):
            await stop.wait()
        if at_hand:
            await at_hand.close()


if __name__ == "__main__":
    sys.exit(main())
