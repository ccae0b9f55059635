"""The person at the simulated cell, and the measuring machine: JSON lines over a unix socket.

`{"do": "seat_golden_assembly"}` and the like, answered by `{"ok": true, ...}` or `{"error": "..."}`. A controller
never uses it; demo and tests do, for what a person does by hand at a real cell and for the truth about each unit.
"""

import asyncio
import json
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from simulators.supply import Delivery, Displacement, Sizes
from simulators.world import World

LONGEST_LINE = 1 << 20

Answer = dict[str, Any]


class Person:
    """Serves one socket."""

    def __init__(self, world: World, path: Path) -> None:
        self._world = world
        self._path = path
        self._verbs: dict[str, Callable[..., Answer | None]] = {
            "seat_golden_assembly": world.seat_golden_assembly,
            "lay_reference_battery": world.lay_reference_battery,
            "clear_station": world.clear_station,
            "inject": self._inject,
            "queue": self._queue,
            "repeatability": self._repeatability,
            "verdicts": self._verdicts,
            "state": self._state,
        }

    async def start(self) -> None:
        """Listen."""
        self._path.unlink(missing_ok=True)
        self._server = await asyncio.start_unix_server(self._serve, self._path, limit=LONGEST_LINE)
        os.chmod(self._path, 0o600)

    async def close(self) -> None:
        """Stop listening."""
        self._server.close()
        self._path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self._answer(line)).encode() + b"\n")
                await writer.drain()
        except (ConnectionError, ValueError):
            pass  # the other side went away, or sent a line without end
        finally:
            writer.close()

    def _answer(self, line: bytes) -> Answer:
        try:
            asked = json.loads(line)
            verb = self._verbs[asked.pop("do")]
            return {"ok": True, **(verb(**asked) or {})}
        except KeyError as error:
            return {"error": f"unknown: {error}; there are: {', '.join(self._verbs)}"}
        except (ValueError, TypeError, AttributeError) as error:
            return {"error": str(error)}

    def _inject(self, component: str, fault: str, **params: object) -> None:
        self._world.inject(component, fault, **params)

    def _queue(self, deliveries: list[dict[str, list[float]]]) -> None:
        self._world.queue_deliveries(
            [
                Delivery(Displacement(*entry["base"]), Displacement(*entry["battery"]), Sizes(*entry.get("sizes", [])))
                for entry in deliveries
            ]
        )

    def _repeatability(self, mm: float, deg: float) -> None:
        self._world.arm.repeatability_mm = float(mm)
        self._world.arm.repeatability_deg = float(deg)

    def _verdicts(self, since: int = 0) -> Answer:
        return {
            "verdicts": [
                {
                    "number": v.number,
                    "carrier_id": v.carrier_id,
                    "base": list(asdict(v.base).values()),
                    "battery": list(asdict(v.battery).values()),
                    "placed": v.fit is not None,
                    "good": v.fit is not None and v.fit.good,
                    "clearance_mm": v.fit.clearance_mm if v.fit else None,
                    "placement_error_mm": v.fit.worst_mm if v.fit else None,
                    "corner_errors_mm": list(v.fit.corner_errors_mm) if v.fit else None,
                    "released_good": v.released_good,
                    "cycle_s": v.cycle_s,
                }
                for v in self._world.verdicts[since:]
            ]
        }

    def _state(self) -> Answer:
        world = self._world
        return {
            "world_s": world.clock.now(),
            "holding": type(world.held).__name__ if world.held else None,
            "base_at_station": world.base is not None,
            "lost": len(world.lost),
            "rejected": len(world.rejected),
            "moving": world.arm.moving_at(world.clock.now()),
        }
