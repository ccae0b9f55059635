"""What the robot driver costs: round trips against a bare client on the same line, processor time per move, parsing;
and how long the arm takes for a unit, predicted and simulated.

`python -m tests.benchmarks.bench_robot` talks to simulated controllers of both generations, each a process of its own
in real time, over TCP and over a 9600 baud pseudo terminal, prints a table and writes build/bench-robot.json.
`--questions` and `--moves` make it shorter or longer. The simulated controller thinks 2 ms about each line.
"""

import argparse
import asyncio
import json
import os
import re
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellctl.config import load_config
from cellctl.recipe import load_recipe
from drivers import rcx
from drivers.link_lines import LineSplitter
from drivers.rcx2 import Rcx2
from drivers.rcx3 import Rcx3
from drivers.rcx_dialect import Dialect
from drivers.reach import Limits
from drivers.robot import Point, Robot
from tests.arm_times import moved, predicted, ways_of
from tests.robot_bench import controller_on

ROOT = Path(__file__).resolve().parents[2]
OUT = Path("build/bench-robot.json")
BAUD, BITS_PER_BYTE = 9600, 11  # start, eight, parity, stop
QUESTIONS, MOVES, LINES = 300, 40, 200_000
QUESTION, SHORTEST = b"@?WHERE\r\n", 20  # the place in pulses, and no answer to it has fewer bytes
PLACES = (Point(250.0, 0.0, 0.0, 0.0), Point(255.0, 5.0, 2.0, 5.0))

ANSWERS: dict[str, tuple[bytes, ...]] = {
    "rcx3": (b"250.000 -12.500 10.000 0.000 0.000 0.000 1 0 0", b"OK", b"RUN", b"END", b"NG=6.204", b"2", b"1 1,1,1,1"),
    "rcx2": (b"[POS]  250.00  -12.50   10.00    0.00    0.00    0.00", b"OK", b"5.52:Command does not exist", b"AUTO"),
}
PULSES = {"rcx3": b"-124761 302264 0 -41602 0 0", "rcx2": b"[POS] -124761  302264       0  -41602       0       0"}
STATUS: dict[str, tuple[str, ...]] = {
    "rcx3": ("2", "0", "0.0", "2", "1 1,1,1,1", "1 1,1,1,1"),
    "rcx2": ("AUTO", "OFF", "ON,99991111", "COMPLETE", "6"),
}


class Lines(NamedTuple):
    """Where a simulated controller is to be found, and where a bare terminal is."""

    port: int
    tty: str


@contextmanager
def controller(dialect: str) -> Iterator[Lines]:
    """A simulated controller as a process of its own, in real time."""
    command = [sys.executable, "-m", "simulators.robot", "--dialect", dialect, "--tcp", "127.0.0.1:0", "--serial"]
    process = subprocess.Popen([*command, str(BAUD)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        told = ""
        while "Ctrl-C" not in told:
            told += process.stdout.readline()
        port, terminal = re.search(r"tcp://127\.0\.0\.1:(\d+)", told), re.search(r"serial:(\S+)\?", told)
        yield Lines(int(_found(port)), _found(terminal))
    finally:
        process.terminate()
        process.wait(10)
        process.stdout.close()


def _found(match: re.Match[str] | None) -> str:
    assert match is not None, "the simulated controller did not say where it is"
    return match[1]


def bare_tcp(lines: Lines, ends: bytes, questions: int) -> list[float]:
    """Round trips of a client that does nothing but wait, ms."""
    with socket.create_connection(("127.0.0.1", lines.port), timeout=5) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(0.3)
        try:
            while connection.recv(1000):
                pass  # the greeting
        except TimeoutError:
            connection.settimeout(5)
        found = [_round_trip(connection.sendall, connection.recv, ends) for _ in range(questions)]
        connection.sendall(b"LOGOUT\r\n")
    return found


def bare_terminal(lines: Lines, ends: bytes, questions: int) -> list[float]:
    """The same on the pseudo terminal."""
    terminal = os.open(lines.tty, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(terminal)
        send, receive = (lambda data: os.write(terminal, data)), (lambda count: os.read(terminal, count))
        return [_round_trip(send, receive, ends) for _ in range(questions)]
    finally:
        os.close(terminal)


def _round_trip(send: Callable[[bytes], Any], receive: Callable[[int], bytes], ends: bytes) -> float:
    since_s = time.perf_counter()
    send(QUESTION)
    answer = b""
    while not answer.endswith(ends) or len(answer) < SHORTEST:
        answer += receive(1000)
    return (time.perf_counter() - since_s) * 1000


async def driven(address: str, dialect: str, questions: int, moves: int) -> tuple[list[float], float]:
    """Round trips of the driver in ms, and its processor time per move in ms."""
    robot = Robot(address, limits=Limits(), dialect=dialect)
    try:
        await robot.open()
        trips = []
        for _ in range(questions):
            since_s = time.perf_counter()
            await robot.points.here()
            trips.append((time.perf_counter() - since_s) * 1000)
        await robot.power_on()
        await robot.move(PLACES[1], speed_pct=100)
        since_s = time.process_time()
        for number in range(moves):
            await robot.move(PLACES[number % 2], speed_pct=100)
        return trips, (time.process_time() - since_s) / moves * 1000
    finally:
        await robot.close()


def line_ms(dialect: str) -> float:
    """How long the bytes of question and answer take on the serial line."""
    ends = b"\r\nOK\r\n" if dialect == "rcx3" else b"\r\n"
    return (len(QUESTION) + len(PULSES[dialect] + ends)) * BITS_PER_BYTE / BAUD * 1000


def parsed_per_s(dialect: Dialect, lines: int) -> float:
    """Received lines per second: bytes to lines, what each is for, and its numbers."""
    said, status = ANSWERS[dialect.name], STATUS[dialect.name]
    chunk, splitter = b"".join(line + b"\r\n" for line in said), LineSplitter(telnet=True)
    rounds, since_s = max(lines // (len(said) + len(status)), 1), time.perf_counter()
    for _ in range(rounds):
        for line in splitter.feed(chunk)[0]:
            if rcx.classify(line) is rcx.Kind.DATA:
                rcx.parse_position(line)
            else:
                rcx.parse_failure(line)
        assert dialect.status(status) is not None
    return rounds * (len(said) + len(status)) / (time.perf_counter() - since_s)


def measure(
    dialect: str, questions: int, moves: int, wanted: Sequence[str] = ("tcp", "serial")
) -> list[dict[str, Any]]:
    """One row for each line of one controller."""
    ends = b"OK\r\n" if dialect == "rcx3" else b"\r\n"
    rows = []
    with controller(dialect) as lines:
        fronts = {
            "tcp": (bare_tcp, f"tcp://127.0.0.1:{lines.port}", 0.0),
            "serial": (bare_terminal, f"serial:{lines.tty}?baud={BAUD}&parity=odd&flow=xonxoff", line_ms(dialect)),
        }
        for front in wanted:
            bare, address, on_line_ms = fronts[front]
            print(f"{dialect} over {front} ...", file=sys.stderr, flush=True)
            alone = bare(lines, ends, questions)
            time.sleep(0.3)  # the controller notices that the bare client has left
            trips, cpu_ms = asyncio.run(driven(address, dialect, questions, moves))
            rows.append(_row(dialect, front, alone, trips) | {"line_ms": on_line_ms, "cpu_per_move_ms": cpu_ms})
    return rows


def _row(dialect: str, front: str, alone: list[float], trips: list[float]) -> dict[str, Any]:
    (bare_p50, bare_p99), (p50, p99) = np.percentile(alone, (50, 99)), np.percentile(trips, (50, 99))
    return {
        "dialect": dialect,
        "line": front,
        "bare_p50_ms": float(bare_p50),
        "bare_p99_ms": float(bare_p99),
        "driver_p50_ms": float(p50),
        "driver_p99_ms": float(p99),
        "driver_adds_ms": float(p50 - bare_p50),
    }


async def unit_times(recipe_name: str = "x85") -> dict[str, float]:
    """The arm's own time in a unit, s: predicted, of the simulated arm, and with the whole way down slow."""
    async with controller_on(speed=5) as (_, controller):
        config = load_config(ROOT / "deploy" / "simulated-cell.toml")
        here = {"address": f"tcp://127.0.0.1:{controller.port}"}
        config = config.model_copy(update={"robot": config.robot.model_copy(update=here)})
        recipe = load_recipe(config.paths.recipes, recipe_name)
        slow = recipe.model_copy(update={"motion": recipe.motion.model_copy(update={"touch_mm": None})})
        ways = ways_of(config, recipe)
        _, found = await moved(config, ways, controller.log)
        expected, before = predicted(config, ways), predicted(config, ways_of(config, slow))
    off = [abs(a / b - 1) for a, b in zip(found, expected, strict=True)]
    return {
        "predicted_s": sum(expected),
        "simulated_s": sum(found),
        "worst_stretch_off_percent": max(off) * 100,
        "slow_way_down_s": sum(before),
        "ratio": sum(expected) / sum(before),
    }


def run(questions: int, moves: int, lines: int) -> dict[str, Any]:
    """Everything."""
    rows = [row for dialect in ("rcx3", "rcx2") for row in measure(dialect, questions, moves)]
    parsing = {dialect.name: parsed_per_s(dialect, lines) for dialect in (Rcx3(), Rcx2())}
    unit = asyncio.run(unit_times())
    return {"round_trips": rows, "lines_parsed_per_s": parsing, "unit": unit, "questions": questions, "moves": moves}


def table(result: dict[str, Any]) -> str:
    """For people."""
    head = f"{'round trip, ms':<16}{'bytes alone':>12}{'bare p50':>10}{'p99':>8}{'driver p50':>12}{'p99':>8}{'adds':>7}"
    lines = [f"{head}{'cpu per move ms':>17}"]
    for row in result["round_trips"]:
        numbers = f"{row['bare_p50_ms']:>10.2f}{row['bare_p99_ms']:>8.2f}{row['driver_p50_ms']:>12.2f}"
        numbers += f"{row['driver_p99_ms']:>8.2f}{row['driver_adds_ms']:>7.2f}{row['cpu_per_move_ms']:>17.2f}"
        lines.append(f"{row['dialect'] + ' ' + row['line']:<16}{row['line_ms']:>12.2f}{numbers}")
    lines += [f"parsed by {name}: {per_s:,.0f} lines/s" for name, per_s in result["lines_parsed_per_s"].items()]
    unit = result["unit"]
    lines.append(
        f"the arm in a unit: predicted {unit['predicted_s']:.3f} s, simulated {unit['simulated_s']:.3f} s, "
        f"worst stretch {unit['worst_stretch_off_percent']:.1f} % off"
    )
    lines.append(f"with the whole way down slow {unit['slow_way_down_s']:.3f} s: ratio {unit['ratio']:.3f}")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--questions", type=int, default=QUESTIONS)
    parser.add_argument("--moves", type=int, default=MOVES)
    given = parser.parse_args()
    result = run(given.questions, given.moves, LINES)
    print(table(result))
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
