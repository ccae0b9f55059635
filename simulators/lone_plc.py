"""The PLC as a program of its own: `python -m simulators plc --tcp 127.0.0.1:5020`, for any Modbus TCP client."""

import argparse
import asyncio
import json
import sys
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import TextIO

from simulators.modbus import Exchange, Units
from simulators.modbus_requests import FUNCTIONS
from simulators.person import Person
from simulators.plc import PlcServer
from simulators.plc_program import DELIVERED, PlcProgram
from simulators.product import load_product
from simulators.running import exact_loop, host_port, until_stopped
from simulators.st.errors import StError
from simulators.world import World

DEFAULT_TCP = "127.0.0.1:5020"
UNIT_IDS = range(1, 248)


def main(arguments: list[str]) -> int:
    """Run until SIGINT or SIGTERM. Exit codes: 0 stopped, 1 cannot listen or no such program, 2 wrong arguments."""
    given = _parser().parse_args(arguments)
    try:
        with asyncio.Runner(loop_factory=exact_loop) as runner:
            runner.run(_serve(given))
    except OSError as error:
        what = f"cannot use {error.filename}" if error.filename else "cannot listen"
        print(f"simulated PLC: {what}: {error.strerror or error}", file=sys.stderr)
        return 1
    except StError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="cellctl simulate plc",
        description="A simulated PLC with conveyor, clamp and vacuum, for any Modbus TCP client. Its register map: "
        "deploy/plc/README.md. Function codes: " + ", ".join(map(str, FUNCTIONS)) + ".",
    )
    parser.add_argument("--tcp", type=host_port, default=DEFAULT_TCP, metavar="HOST:PORT", help="default %(default)s")
    parser.add_argument("--unit", type=_unit, default=1, metavar="ID", help="its unit id (default %(default)s)")
    parser.add_argument(
        "--units",
        choices=[each.value for each in Units],
        default=Units.OWN.value,
        help="whom it serves: its own id, 0 and 255; any id; or, as a gateway, its own id and broadcasts to 0",
    )
    parser.add_argument(
        "--without", type=int, choices=FUNCTIONS, action="append", default=[], metavar="CODE", help="it lacks this one"
    )
    parser.add_argument("--program", type=Path, default=DELIVERED, metavar="FILE", help="Structured Text to execute")
    parser.add_argument("--product", type=Path, default=Path("recipes/x85.toml"), help="recipe file with the drawing")
    parser.add_argument("--seed", type=int, default=1, help="of the carriers' scatter")
    parser.add_argument("--speed", type=float, default=1.0, help="world seconds per second (default 1: real time)")
    parser.add_argument("--person", type=Path, help="unix socket for the person at the cell (JSON lines)")
    parser.add_argument("--log", type=Path, help="file for every request and its answer (JSON lines)")
    return parser


def _unit(text: str) -> int:
    if not text.isdecimal() or int(text) not in UNIT_IDS:
        raise argparse.ArgumentTypeError(f"{text!r} is not a unit id from {UNIT_IDS[0]} to {UNIT_IDS[-1]}")
    return int(text)


async def _serve(given: argparse.Namespace) -> None:
    world = World(given.seed, load_product(given.product), speed=given.speed)
    host, port = given.tcp
    program = partial(PlcProgram, source=given.program)
    plc = PlcServer(world, host=host, port=port, unit_id=given.unit, program=program)
    plc.modbus.units, plc.modbus.lacking = Units(given.units), frozenset(given.without)
    async with AsyncExitStack() as stack:
        if given.log is not None:
            plc.modbus.listener = partial(_write, stack.enter_context(given.log.open("w", encoding="utf-8")))
        await plc.start()
        stack.push_async_callback(plc.close)
        if given.person is not None:
            person = Person(world, given.person)
            await person.start()
            stack.push_async_callback(person.close)
        _print_where(given, host, plc.port)
        await until_stopped()


def _print_where(given: argparse.Namespace, host: str, port: int) -> None:
    print(f"PLC       Modbus TCP    {host}:{port}, unit {given.unit} ({given.units})")
    print(f"try       mbpoll -0 -1 -a {given.unit} -p {port} -r 100 -c 32 {host}")
    if given.person is not None:
        print(f'person    {given.person}      {{"do": "inject", "component": "safety", "fault": "estop"}}')
    print(f"world     speed {given.speed:g}; stop with Ctrl-C", flush=True)


def _write(file: TextIO, exchange: Exchange) -> None:
    answer = exchange.answer
    entry = exchange._asdict() | {"request": exchange.request.hex(" "), "answer": answer and answer.hex(" ")}
    file.write(json.dumps(entry) + "\n")
    file.flush()
