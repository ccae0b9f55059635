"""What the PLC driver costs: an exchange beside libmodbus' C client, a 10 ms scan, the loop beside vision, bad answers.

`make bench-plc` prints a table and writes build/bench-plc.json. All clients speak to the same simulated servers, which
are processes of their own. The C client is compiled here from plc/exchange.c and needs cc and libmodbus-dev.
"""

import argparse
import asyncio
import json
import multiprocessing
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pymodbus.client import AsyncModbusTcpClient

from cellctl.daemon import SWITCH_S
from drivers.modbus import ModbusLink
from drivers.plc import Plc
from simulators.modbus import ModbusServer
from simulators.modbus_bank import Bank
from simulators.plc import PlcServer
from simulators.running import exact_loop
from tests.benchmarks.bench_reaction import vision
from tests.plc_belt import Belt
from tests.plc_storm import storm

OUT = Path("build/bench-plc.json")
SOURCE = Path(__file__).parent / "plc" / "exchange.c"
EXCHANGES, ROUNDS, SCAN_S, BAD_ANSWERS = 5000, 5, 20.0, 10_000
PERIOD_S, PROGRESS_S = 0.01, 2.0
GOAL_CPU_PCT = 4.0
WORDS = [0] * 16
Exchange = Callable[[], Awaitable[object]]


# -- servers -----------------------------------------------------------------------------------------------------


async def _bare() -> int:
    """A server that only keeps registers."""
    server = ModbusServer(Bank(holding=[*range(16), *range(100, 132)]))
    await server.start()
    return server.port


async def _plc() -> int:
    """The simulated PLC with its program, in real time."""
    server = PlcServer(Belt(1.0))
    await server.start()
    return server.port


def _serve(port: Connection, start: Callable[[], Awaitable[int]]) -> None:
    async def serve() -> None:
        port.send(await start())
        await asyncio.Event().wait()

    with asyncio.Runner(loop_factory=exact_loop) as runner:
        runner.run(serve())


@contextmanager
def serving(start: Callable[[], Awaitable[int]]) -> Iterator[int]:
    """In a process of its own; the port."""
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_serve, args=(theirs, start), daemon=True)
    process.start()
    theirs.close()  # so that a process that ends at once is noticed
    try:
        yield ours.recv()
    finally:
        process.kill()
        process.join()


# -- one exchange --------------------------------------------------------------------------------------------------


def exchanges(port: int, count: int, program: Path | None) -> dict[str, dict[str, float]]:
    """Back to back, all clients in turns, so that a busy computer disturbs them alike. None: without the C client."""
    clients: dict[str, Callable[[int], list[float]]] = {
        "driver": lambda number: run(by_driver(port, number)),
        "pymodbus": lambda number: run(by_pymodbus(port, number)),
    }
    if program is not None:
        clients = {"libmodbus, C": lambda number: by_c(program, port, number), **clients}
    taken: dict[str, list[float]] = {name: [] for name in clients}
    for number in range(ROUNDS):
        _tell(f"exchanges: round {number + 1} of {ROUNDS}")
        for name, measure_one in clients.items():
            taken[name] += measure_one(count // ROUNDS)
    return {name: of(times_us, "us") for name, times_us in taken.items()}


def compiled(folder: Path) -> Path:
    """The C client. Ends the program with a sentence when it cannot be made."""
    program = folder / "exchange"
    command = ["cc", "-O2", "-o", str(program), str(SOURCE), "-I/usr/include/modbus", "-lmodbus"]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    except FileNotFoundError:
        raise SystemExit("no C compiler; apt-get install gcc libmodbus-dev") from None
    except subprocess.CalledProcessError as error:
        raise SystemExit(f"cannot compile {SOURCE}; apt-get install gcc libmodbus-dev\n{error.stderr}") from None
    return program


def by_c(program: Path, port: int, count: int) -> list[float]:
    command = [str(program), "127.0.0.1", str(port), str(count)]
    lines = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout.split()
    return [int(line) / 1000 for line in lines]


async def by_driver(port: int, count: int) -> list[float]:
    link = ModbusLink("plc", "127.0.0.1", port)
    await link.open()
    times_us = await timed(lambda: link.read_write(100, 32, 0, WORDS), count)
    link.close()
    return times_us


async def by_pymodbus(port: int, count: int) -> list[float]:
    client = AsyncModbusTcpClient("127.0.0.1", port=port, retries=0, reconnect_delay=0)
    await client.connect()
    ask = exchange_of(client)
    times_us = await timed(ask, count)
    client.close()
    return times_us


def exchange_of(client: AsyncModbusTcpClient) -> Exchange:
    return lambda: client.readwrite_registers(
        read_address=100, read_count=32, write_address=0, values=WORDS, device_id=1
    )


async def timed(exchange: Exchange, count: int) -> list[float]:
    times_us = []
    for _ in range(count):
        start_s = time.perf_counter()
        await exchange()
        times_us.append(1e6 * (time.perf_counter() - start_s))
    return times_us


# -- the scan ------------------------------------------------------------------------------------------------------


async def scan_cost(port: int, for_s: float) -> dict[str, float]:
    """Processor time of this process while the driver scans."""
    plc = Plc("127.0.0.1", port, scan_period_s=PERIOD_S)
    scan = asyncio.create_task(plc.run())
    await plc.ready(within_s=3)
    watch = asyncio.create_task(plc.unsafe())  # as the cell does, always
    scans, cpu_s = plc.scans, time.process_time()
    await asyncio.sleep(for_s)
    scans, cpu_s = plc.scans - scans, time.process_time() - cpu_s
    for task in (watch, scan):
        task.cancel()
    await asyncio.wait([watch, scan])
    return share(cpu_s, scans)


async def pymodbus_cost(port: int, for_s: float) -> dict[str, float]:
    """The bare exchange through pymodbus, at the same rate."""
    client = AsyncModbusTcpClient("127.0.0.1", port=port, retries=0, reconnect_delay=0)
    await client.connect()
    found = await paced(exchange_of(client), for_s)
    client.close()
    return found


async def idle_cost(for_s: float) -> dict[str, float]:
    """A loop that only wakes up at the same rate."""

    async def nothing() -> None:
        pass

    return await paced(nothing, for_s)


async def paced(exchange: Exchange, for_s: float) -> dict[str, float]:
    loop = asyncio.get_running_loop()
    due_s, rounds, cpu_s = loop.time(), round(for_s / PERIOD_S), time.process_time()
    for _ in range(rounds):
        await exchange()
        due_s = max(due_s + PERIOD_S, loop.time())
        await asyncio.sleep(due_s - loop.time())
    return share(time.process_time() - cpu_s, rounds)


def share(cpu_s: float, rounds: int) -> dict[str, float]:
    """Of a core at the nominal rate, whatever rate a busy computer allowed."""
    return {"cpu_pct": round(100 * cpu_s / rounds / PERIOD_S, 2), "us_each": round(1e6 * cpu_s / rounds)}


# -- the loop beside vision ----------------------------------------------------------------------------------------


async def lateness(port: int, for_s: float) -> list[float]:
    """How late a timer of 10 ms comes, in ms, while the driver scans on the same loop."""
    loop = asyncio.get_running_loop()
    plc = Plc("127.0.0.1", port, scan_period_s=PERIOD_S)
    scan = asyncio.create_task(plc.run())
    await plc.ready(within_s=3)
    late_ms = []
    for _ in range(round(for_s / PERIOD_S)):
        due_s = loop.time() + PERIOD_S
        await asyncio.sleep(PERIOD_S)
        late_ms.append(1e3 * (loop.time() - due_s))
    scan.cancel()
    await asyncio.wait([scan])
    return late_ms


# -- all of it -----------------------------------------------------------------------------------------------------


def measure(exchange_count: int, for_s: float, bad_answers: int, program: Path | None = None) -> dict[str, Any]:
    sys.setswitchinterval(SWITCH_S)
    cv2.setNumThreads(1)
    result: dict[str, Any] = {}
    with serving(_bare) as bare, serving(_plc) as plc:
        result["exchange"] = exchanges(bare, exchange_count, program)
        _tell("scan at 10 ms")
        result["scan"] = {
            "driver, words decoded and watched": run(scan_cost(plc, for_s)),
            "pymodbus, bare exchange": run(pymodbus_cost(plc, for_s)),
            "nothing, only waking up": run(idle_cost(for_s)),
        }
        for name, on in (("no vision", False), ("5 MP vision without a pause", True)):
            _tell(f"loop with {name}")
            with vision(on):
                result.setdefault("late", {})[name] = of(run(lateness(plc, for_s)), "ms")
    sent, taken = run(storm(bad_answers, now_and_then(lambda bad: _tell(f"bad answers: {bad} of {bad_answers}"))))
    result["storm"] = {"sent": dict(sent), "taken": dict(taken)}
    _tell("", end="\n")
    result["goal_met"] = result["scan"]["driver, words decoded and watched"]["cpu_pct"] <= GOAL_CPU_PCT
    return result


def run(work: Any) -> Any:
    with asyncio.Runner(loop_factory=exact_loop) as runner:
        return runner.run(work)


def of(values: list[float], unit: str) -> dict[str, float]:
    p50, p99 = (float(np.quantile(values, share)) for share in (0.5, 0.99))
    return {f"p50_{unit}": round(p50, 2), f"p99_{unit}": round(p99, 2), f"max_{unit}": round(max(values), 2)}


def now_and_then(tell: Callable[[int], None]) -> Callable[[int], None]:
    """Not more often than every two seconds."""
    told_s = 0.0

    def maybe(number: int) -> None:
        nonlocal told_s
        if time.monotonic() - told_s > PROGRESS_S:
            told_s = time.monotonic()
            tell(number)

    return maybe


def _tell(text: str, end: str = "") -> None:
    print(f"\r\033[K{text}", end=end, file=sys.stderr, flush=True)


def show(result: dict[str, Any]) -> None:
    print(f"{'one FC23 exchange, us':<44}{'p50':>8}{'p99':>9}{'max':>10}")
    for name, row in result["exchange"].items():
        print(f"  {name:<42}{row['p50_us']:>8.0f}{row['p99_us']:>9.0f}{row['max_us']:>10.0f}")
    print("scan of 10 ms, share of a core")
    for name, row in result["scan"].items():
        print(f"  {name:<42}{row['cpu_pct']:>7} %{row['us_each']:>7} us each")
    print(f"{'a 10 ms timer is late, ms':<44}{'p50':>8}{'p99':>9}{'max':>10}")
    for name, row in result["late"].items():
        print(f"  {name:<42}{row['p50_ms']:>8}{row['p99_ms']:>9}{row['max_ms']:>10}")
    sent, taken = result["storm"]["sent"], result["storm"]["taken"]
    bad = ", ".join(f"{count} {name}" for name, count in sent.items() if name != "right")
    print(f"bad answers: {bad}\n  pictures taken right {taken['right']}, wrong {taken.get('wrong', 0)}")
    print(f"goal: scan <= {GOAL_CPU_PCT:g} % of a core: {'met' if result['goal_met'] else 'MISSED'}")


def main(exchange_count: int, for_s: float, bad_answers: int, out: Path = OUT) -> None:
    with tempfile.TemporaryDirectory() as folder:
        result = measure(exchange_count, for_s, bad_answers, compiled(Path(folder)))
    show(result)
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--exchanges", type=int, default=EXCHANGES, help="of each client")
    parser.add_argument("--seconds", type=float, default=SCAN_S, help="of each run at 10 ms")
    parser.add_argument("--bad-answers", type=int, default=BAD_ANSWERS)
    arguments = parser.parse_args()
    main(arguments.exchanges, arguments.seconds, arguments.bad_answers)
