"""`cellctl plc watch`: the live register map, from the daemon or from the PLC itself; nothing is ever written."""

import asyncio
import json
import sys
import time
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Any, NamedTuple

import click

from cellctl.config import CellConfig
from cellctl.control.plc_report import report
from cellctl.desk.client import NotReachable, call
from drivers.errors import DeviceError
from drivers.plc_ages import Ages
from drivers.plc_layout import PlcAddress
from drivers.plc_port import PlcPort
from drivers.plc_registers import READ_COUNT, WRITE_COUNT
from drivers.plc_tags import Packet, Seen

ANSWER_WITHIN_S = 0.5
MOST_PACKETS = 400
CLEAR = "\x1b[H\x1b[J"
Report = dict[str, Any]


class Wanted(NamedTuple):
    """How the map is to be shown."""

    once: bool
    period_s: float
    direct: bool
    wire: bool
    as_json: bool


class DirectReader:
    """Reads the map over a connection of its own, by reading function codes only: the PLC's session is not touched."""

    def __init__(self, address: PlcAddress) -> None:
        self._address = address
        self._port: PlcPort | None = None
        self._transaction = 0
        self._cell, self._plc = Ages(WRITE_COUNT), Ages(READ_COUNT)
        self._packets: deque[Packet] = deque(maxlen=MOST_PACKETS)

    async def look(self, packets: int) -> Report:
        """The map as it is now. Raises DeviceError."""
        try:
            port = self._port or await self._opened()
            asked_at_s = time.monotonic()
            cell, plc = await port.cell_words(), await port.picture()
        except DeviceError:
            self.close()
            raise
        self._cell.take(cell, asked_at_s)
        self._plc.take(plc, asked_at_s)
        return report(Seen(time.monotonic(), self._cell, self._plc, tuple(self._packets), ""), packets)

    async def _opened(self) -> PlcPort:
        self._port = PlcPort(
            "plc", self._address, within_s=ANSWER_WITHIN_S, transaction=self._transaction, wire_log=self._note
        )
        await self._port.open()
        return self._port

    def close(self) -> None:
        """Leave the connection to others; the next look opens it again."""
        if self._port is not None:
            self._port.close()
            self._transaction, self._port = self._port.transaction, None

    def _note(self, sent: bool, data: bytes) -> None:
        self._packets.append(Packet(time.monotonic(), sent, data))


def watch_plc(config: CellConfig, wanted: Wanted) -> int:
    """Show the map until Ctrl-C, or once. Raises DeviceError when even the first look fails."""
    return asyncio.run(_watch(config, wanted))


async def _watch(config: CellConfig, wanted: Wanted) -> int:
    last_s = 0.0
    async with aclosing(_reports(config, wanted)) as reports:
        async for found in reports:
            if wanted.wire:
                last_s = _show_wire(found, last_s, as_json=wanted.as_json)
            elif wanted.as_json:
                click.echo(json.dumps({key: found[key] for key in ("source", "trouble", "values")}))
            else:
                click.echo(_table(found))
            if wanted.once:
                return 0
    return 0


async def _reports(config: CellConfig, wanted: Wanted) -> AsyncGenerator[Report, None]:
    """One after the other; after the first one trouble is reported and not raised."""
    direct = DirectReader(config.plc.address)
    last: Report | None = None
    try:
        while True:
            try:
                last = await _look(config, direct, wanted)
            except DeviceError as error:
                if last is None:
                    raise
                last = {**last, "trouble": error.detail}
            yield last
            await asyncio.sleep(wanted.period_s)
    finally:
        direct.close()


async def _look(config: CellConfig, direct: DirectReader, wanted: Wanted) -> Report:
    packets = MOST_PACKETS if wanted.wire else 0
    if not wanted.direct:
        try:
            found = await call(config.paths.control_socket, {"verb": "plc", "packets": packets})
        except NotReachable:
            pass  # no daemon: the PLC itself is asked
        else:
            direct.close()
            return {"source": "daemon", **found}
    return {"source": f"PLC at {config.plc.address}", **await direct.look(packets)}


def _show_wire(found: Report, after_s: float, *, as_json: bool) -> float:
    """The packets after that time; the time of the last one."""
    for packet in found["packets"]:
        if packet["at_s"] > after_s:
            after_s = packet["at_s"]
            click.echo(json.dumps(packet) if as_json else f"{packet['at_s']:.4f} {packet['text']}")
    return after_s


def _table(found: Report) -> str:
    """One line per value: address, name, value, age, time since it changed."""
    rows = [
        (str(value["address"]), value["name"], value["text"], _ago(value["age_ms"]), _ago(value["unchanged_ms"]))
        for value in found["values"]
    ]
    head = ("addr", "name", "value", "age", "unchanged")
    widths = [max(len(row[at]) for row in (head, *rows)) for at in range(len(head))]
    lines = [f"{found['source']}{': ' if found['trouble'] else ''}{found['trouble']}"]
    for addr, name, value, age, unchanged in (head, *rows):
        left = f"{addr:>{widths[0]}}  {name:<{widths[1]}}  {value:<{widths[2]}}"
        lines.append(f"{left}  {age:>{widths[3]}}  {unchanged:>{widths[4]}}")
    clear = CLEAR if sys.stdout.isatty() else ""
    return clear + "\n".join(lines)


def _ago(ms: int) -> str:
    return f"{ms} ms" if ms < 10_000 else f"{ms / 1000:.0f} s"
