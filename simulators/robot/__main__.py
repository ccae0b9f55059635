"""One robot controller as a program of its own: `python -m simulators.robot --dialect rcx2 --serial 9600`."""

import argparse
import asyncio
import json
import sys
from contextlib import AsyncExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any, TextIO

from simulators.robot.bench import Bench
from simulators.robot.controller import DIALECTS, RobotController
from simulators.robot.log import Entry
from simulators.robot.options import Options, with_settings
from simulators.running import exact_loop, host_port, until_stopped
from simulators.scara import MODELS
from simulators.verb_socket import VerbSocket

CONTROLLERS = {"rcx3": "RCX340", "rcx2": "RCX240"}
FIRST_COMMANDS = {"rcx3": "@?MODE  @MOTOR ON  @?WHRXY", "rcx2": "@?MOD  @SERVO ON  @?WHRXY"}
BAUDS = (4800, 9600, 19200, 38400, 57600, 115200)
DEFAULT_TCP = "127.0.0.1:10023"


def main(arguments: list[str] | None = None) -> int:
    """Run until SIGINT or SIGTERM. Exit codes: 0 stopped, 1 cannot listen, 2 wrong arguments."""
    parser = _parser()
    given = parser.parse_args(arguments)
    try:
        options = with_settings(Options(), given.option)
    except ValueError as error:
        parser.error(str(error))
    try:
        with asyncio.Runner(loop_factory=exact_loop) as runner:
            runner.run(_serve(given, options))
    except OSError as error:
        print(f"simulated robot: cannot listen: {error.strerror or error}; is another one running?", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    names = ", ".join(field.name for field in fields(Options))
    parser = argparse.ArgumentParser(
        prog="cellctl simulate robot",
        description="A simulated Yamaha robot controller with its arm, for any client.",
        epilog=f"Options: {names}. What they mean: simulators/robot/options.py.",
    )
    parser.add_argument("--dialect", choices=DIALECTS, default="rcx3", help="RCX340/RCX320 or RCX240/RCX14x/RCX22x")
    parser.add_argument(
        "--tcp", nargs="?", const=DEFAULT_TCP, type=host_port, metavar="HOST:PORT", help=f"default {DEFAULT_TCP}"
    )
    parser.add_argument(
        "--serial", nargs="?", const=9600, type=int, choices=BAUDS, metavar="BAUD", help="a pseudo terminal, 9600 8-O-1"
    )
    parser.add_argument("--link", type=Path, help="symbolic link to keep pointing at the serial line's terminal")
    parser.add_argument("--model", choices=MODELS, default="yk400xg", help="the arm (default %(default)s)")
    parser.add_argument("--speed", type=float, default=1.0, help="world seconds per second (default 1: real time)")
    parser.add_argument("--seed", type=int, default=7, help="of the arm's scatter and of noise on the line")
    parser.add_argument("--option", action="append", default=[], metavar="NAME=VALUE", help="how the controller is set")
    parser.add_argument("--person", type=Path, help="unix socket for the person at the robot (JSON lines)")
    parser.add_argument("--log", type=Path, help="file for what truly happens (JSON lines)")
    return parser


async def _serve(given: argparse.Namespace, options: Options) -> None:
    bench = Bench(seed=given.seed, speed=given.speed, model=given.model)
    host, port = given.tcp or ("127.0.0.1", None) if given.serial or given.tcp else host_port(DEFAULT_TCP)
    controller = RobotController(
        bench,
        dialect=given.dialect,
        host=host,
        port=port,
        serial_baud=given.serial,
        serial_link=given.link,
        options=options,
    )
    async with AsyncExitStack() as stack:
        if given.log is not None:
            file = stack.enter_context(given.log.open("w", encoding="utf-8"))
            controller.log.listener = lambda entry: _write(file, entry)
        await controller.start()
        stack.push_async_callback(controller.close)
        if given.person is not None:
            person = VerbSocket(_verbs(bench, controller), given.person)
            await person.start()
            stack.push_async_callback(person.close)
        _print_where(given, controller, host, port)
        await until_stopped()


def _print_where(given: argparse.Namespace, controller: RobotController, host: str, port: int | None) -> None:
    dialect = given.dialect
    print(f"robot     {CONTROLLERS[dialect]} ({dialect}) with a {controller.machine.arm.scara.name}")
    if port is not None:
        print(f"network   tcp://{host}:{controller.port}      try: nc -C {host} {controller.port}")
    if given.serial is not None:
        print(f"serial    serial:{controller.tty}?baud={given.serial}&parity=odd&flow=xonxoff")
    print(f"say       {FIRST_COMMANDS[dialect]}")
    if given.person is not None:
        print(f'person    {given.person}      {{"do": "inject", "component": "safety", "fault": "estop"}}')
    print(f"world     speed {given.speed:g}; stop with Ctrl-C", flush=True)


def _verbs(bench: Bench, controller: RobotController) -> dict[str, Any]:
    def inject(component: str, fault: str, **params: object) -> None:
        bench.inject(component, fault, **params)

    def state() -> dict[str, Any]:
        now_s = bench.clock.now()
        return {"world_s": now_s, "tool": bench.arm.tool_at(now_s), "moving": bench.arm.moving_at(now_s)}

    def log(since: int = 0) -> dict[str, Any]:
        return {"log": [_plain(entry) for entry in controller.log.entries if entry.number > since]}

    return {"inject": inject, "state": state, "log": log}


def _plain(entry: Entry) -> dict[str, Any]:
    return {"number": entry.number, "at_s": entry.at_s, "kind": entry.kind, **entry.facts}


def _write(file: TextIO, entry: Entry) -> None:
    file.write(json.dumps(_plain(entry), default=str) + "\n")
    file.flush()


if __name__ == "__main__":
    sys.exit(main())
