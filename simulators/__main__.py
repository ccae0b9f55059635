"""A simulated cell for any client: `python -m simulators`; one device alone: `... plc`, `... robot`, `... camera`."""

import argparse
import asyncio
import sys
from contextlib import suppress
from pathlib import Path

import cv2

from simulators.cell import Addresses, SimulatedCell
from simulators.lone_camera import main as camera_main
from simulators.lone_plc import main as plc_main
from simulators.person import Person
from simulators.plc_program import DELIVERED
from simulators.product import load_product
from simulators.robot.__main__ import CONTROLLERS
from simulators.robot.__main__ import main as robot_main
from simulators.running import exact_loop, host_port, until_stopped
from simulators.st.errors import StError
from simulators.world import World


def main() -> int:
    """Run until SIGINT or SIGTERM."""
    if sys.argv[1:2] == ["robot"]:
        return robot_main(sys.argv[2:])
    if sys.argv[1:2] == ["camera"]:
        return camera_main(sys.argv[2:])
    if sys.argv[1:2] == ["plc"]:
        return plc_main(sys.argv[2:])
    options = _parser().parse_args()
    world = World(options.seed, load_product(options.product), speed=options.speed)
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)  # one thread per camera renders already
    sys.setswitchinterval(0.0005)  # and gives the interpreter back to the protocol servers
    try:
        with asyncio.Runner(loop_factory=exact_loop) as runner:
            runner.run(_serve(world, options))
    except OSError as error:
        print(f"simulated cell: {_why(error)}", file=sys.stderr)
        return 1
    except StError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _why(error: OSError) -> str:
    if error.filename:
        return f"cannot read {error.filename}: {error.strerror}"
    return f"cannot listen: {error.strerror or error}; is another one running?"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cellctl simulate",
        description="A simulated cell: PLC (Modbus TCP), robot, two cameras (GigE Vision or V4L2), one world. "
        "One device alone: cellctl simulate plc --help, robot --help, camera --help.",
    )
    parser.add_argument("--product", type=Path, default=Path("recipes/x85.toml"), help="recipe file with the drawing")
    parser.add_argument("--seed", type=int, default=1, help="which cell: mounts, lenses, parts and scatter")
    parser.add_argument("--speed", type=float, default=1.0, help="world seconds per second (default 1: real time)")
    parser.add_argument("--plc", type=host_port, default="127.0.0.1:5020", metavar="HOST:PORT")
    parser.add_argument(
        "--plc-program", type=Path, default=DELIVERED, metavar="FILE", help="Structured Text to execute"
    )
    parser.add_argument("--robot", type=host_port, default="127.0.0.1:10023", metavar="HOST:PORT")
    parser.add_argument("--robot-serial", type=int, metavar="BAUD", help="offer the robot on a pseudo terminal, too")
    parser.add_argument("--robot-dialect", choices=("rcx3", "rcx2"), default="rcx3", help="an RCX340 or an RCX240")
    parser.add_argument("--camera-1", default="127.0.0.2", metavar="IP|PATH", help="GigE Vision, or a V4L2 file")
    parser.add_argument("--camera-2", default="127.0.0.3", metavar="IP|PATH", help="the same")
    parser.add_argument("--no-trigger", action="store_true", help="V4L2 cameras run free only, as USB cameras do")
    parser.add_argument("--pictures", type=Path, help="folder that gets every picture that a camera takes, as TIFF")
    parser.add_argument("--person", type=Path, help="unix socket for the person at the cell (JSON lines)")
    return parser


def _addresses(options: argparse.Namespace) -> Addresses:
    plc_host, plc_port = options.plc
    robot_host, robot_port = options.robot
    return Addresses(
        plc_host=plc_host,
        plc_port=plc_port,
        robot_host=robot_host,
        robot_port=robot_port,
        camera_1=options.camera_1,
        camera_2=options.camera_2,
        video_triggers=not options.no_trigger,
        robot_serial_baud=options.robot_serial,
        robot_dialect=options.robot_dialect,
    )


async def _serve(world: World, options: argparse.Namespace) -> None:
    addresses = _addresses(options)
    async with SimulatedCell(world, addresses, options.pictures, plc_program=options.plc_program) as cell:
        at_hand = Person(world, options.person) if options.person else None
        if at_hand:
            await at_hand.start()
        robot = CONTROLLERS[addresses.robot_dialect]
        print(f"PLC       Modbus TCP    {addresses.plc_host}:{cell.plc.port}, unit 1")
        print(f"robot     {robot}        {addresses.robot_host}:{cell.robot.port}")
        if addresses.robot_serial_baud:
            print(f"robot     {robot}        serial:{cell.robot.tty}?baud={addresses.robot_serial_baud}")
        for number, address in enumerate((addresses.camera_1, addresses.camera_2), 1):
            kind = "V4L2       " if address.startswith("/") else "GigE Vision"
            print(f"camera {number}  {kind}   {address} (SIM-CAM-{number})")
        print(f"world     seed {world.seed}, speed {world.clock.speed:g}; stop with Ctrl-C", flush=True)
        with suppress(asyncio.CancelledError):
            await until_stopped()
        if at_hand:
            await at_hand.close()


if __name__ == "__main__":
    sys.exit(main())
