"""The person at the simulated cell, and the measuring machine: JSON lines over a unix socket.

`{"do": "seat_golden_assembly"}` and the like, answered by `{"ok": true, ...}` or `{"error": "..."}`. A controller
never uses it; demo and tests do, for what a person does by hand at a real cell and for the truth about each unit.
"""

from dataclasses import asdict
from pathlib import Path

from simulators.supply import Delivery, Displacement, Sizes
from simulators.verb_socket import Answer, Verb, VerbSocket
from simulators.world import World


class Person(VerbSocket):
    """Serves one socket."""

    def __init__(self, world: World, path: Path) -> None:
        self._world = world
        verbs: dict[str, Verb] = {
            "seat_golden_assembly": world.seat_golden_assembly,
            "put_in_golden_pair": world.put_in_golden_pair,
            "lay_reference_battery": world.lay_reference_battery,
            "clear_station": world.clear_station,
            "inject": self._inject,
            "queue": self._queue,
            "repeatability": self._repeatability,
            "verdicts": self._verdicts,
            "state": self._state,
        }
        super().__init__(verbs, path)

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
