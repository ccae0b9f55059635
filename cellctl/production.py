"""Production: one unit after the other, each with exactly one final record."""

import asyncio
import time
from collections.abc import Callable

from cellctl.assembly.hand import COMMAND_WITHIN_S, seeing
from cellctl.assembly.unit import Job, Unit
from cellctl.control.events import Event, unit_event
from cellctl.cycle import assemble
from cellctl.faults import CellError, Reaction, UnitTooSlow, fault_for, sentence
from cellctl.journal import Record, Verdict
from cellctl.log import StepTime, bound, log, trace
from drivers.errors import DeviceError

INTERRUPTED = "aborted before it was finished: look for its battery in the cell"
Publish = Callable[[Event], None]


class Production:
    """Assembles units until told to end; Stop and Hold let the unit in progress end first."""

    ends_with_its_unit = True

    def __init__(self, job: Job, publish: Publish, units: int, count: Callable[[bool], None]) -> None:
        self._job = job
        self._publish = publish
        self._limit = units
        self._count_unit = count
        self.done = 0

    @property
    def text(self) -> str:
        """What it does, for people."""
        of = f" of {self._limit}" if self._limit else ""
        return f"production of {self._job.name}, {self.done}{of} units done"

    async def run(self, keep_on: Callable[[], bool]) -> None:
        """Units, until there are enough or somebody wants it to end."""
        async with seeing(self._job.hand.devices, self._job.recipe):
            await self._job.hand.clear_away()
            log.info(self._job.budget.plan_text)
            while keep_on() and not (self._limit and self.done >= self._limit):
                await self._one_unit()

    async def _one_unit(self) -> None:
        unit = Unit()
        began_s = time.monotonic()
        with bound(), trace() as steps:
            try:
                await self._assemble(unit, steps, began_s)
            finally:
                await self._ensure_record(unit, steps, began_s)
        await self._job.hand.devices.plc.release(unit.carrier_id, good=unit.good, within_s=COMMAND_WITHIN_S)

    async def _ensure_record(self, unit: Unit, steps: list[StepTime], began_s: float) -> None:
        """Aborted, or a software error: the unit still gets its one record; one that is being written is waited for."""
        if unit.recording is not None:
            await asyncio.shield(unit.recording)
        elif unit.id:
            await self._record(unit, Verdict.LOST, INTERRUPTED, steps, began_s)

    async def _assemble(self, unit: Unit, steps: list[StepTime], began_s: float) -> None:
        within_s = self._job.recipe.timing.unit_within_s
        try:
            async with asyncio.timeout(within_s):
                await assemble(self._job, unit)
        except TimeoutError:
            await self._failed(unit, UnitTooSlow(f"not finished within {within_s:g} s"), steps, began_s)
        except (CellError, DeviceError) as error:
            await self._failed(unit, error, steps, began_s)
        else:
            unit.good = True
            await self._record(unit, Verdict.PLACED, "placed", steps, began_s)

    async def _failed(self, unit: Unit, error: CellError | DeviceError, steps: list[StepTime], began_s: float) -> None:
        fault = fault_for(error)
        if fault.reaction is not Reaction.REJECT:
            if unit.id:
                await self._record(unit, Verdict.LOST, sentence(error), steps, began_s, fault.code)
            raise error
        log.warning(f"rejected: {sentence(error)}")
        await self._job.hand.put_away()
        await self._record(unit, Verdict.REJECTED, sentence(error), steps, began_s, fault.code)

    async def _record(
        self,
        unit: Unit,
        verdict: Verdict,
        text: str,
        steps: list[StepTime],
        began_s: float,
        fault: str | None = None,
    ) -> None:
        """The one final record, durable, before the PLC is told."""
        base, battery, prediction = unit.base, unit.battery, unit.prediction
        record = Record(
            verdict=verdict,
            sentence=text,
            fault=fault,
            cycle_s=round(time.monotonic() - began_s, 4),
            base_dx_mm=base and base.dx_mm,
            base_dy_mm=base and base.dy_mm,
            base_dt_deg=base and base.dt_deg,
            battery_dx_mm=battery and battery.dx_mm,
            battery_dy_mm=battery and battery.dy_mm,
            battery_dt_deg=battery and battery.dt_deg,
            predicted_mm=prediction and prediction.p99_mm,
            pictures=tuple(f"{unit.id}-{camera}.jpg" for camera in unit.pictures),
            data={
                "carrier_id": unit.carrier_id,
                "prediction": prediction.as_dict() if prediction else None,
                "placed_at": list(unit.placed_at) if unit.placed_at else None,
                "waited_for_vision_ms": unit.waited_for_vision_ms,
                "looked_again_ms": unit.looked_again_ms,
                "steps_ms": {f"{step.number} {step.name}": step.took_ms for step in steps},
                "recipe": self._job.name,
                "cameras": self._job.recipe.cameras,
                "gap": unit.seating and unit.seating.as_dict(),
                "gap_unseen": unit.gap_unseen,
                "drift": self._job.watch.record(unit.observed),
                "light": self._job.light.record(),
            },
        )
        unit.recording = asyncio.create_task(self._write(unit, record))
        await asyncio.shield(unit.recording)  # once begun it ends, whatever aborts the cell meanwhile

    async def _write(self, unit: Unit, record: Record) -> None:
        await self._job.journal.finish_unit(unit.id, record)
        self._count(unit, record)

    def _count(self, unit: Unit, record: Record) -> None:
        self.done += 1
        self._count_unit(record.verdict is Verdict.PLACED)
        expected = f", {unit.prediction.sentence}" if unit.prediction else ""
        say = log.info if record.verdict is Verdict.PLACED else log.warning
        say(f"unit {record.verdict.value} in {record.cycle_s:.2f} s{expected}", unit=unit.id)
        data = {
            "carrier_id": unit.carrier_id,
            "base": unit.base,
            "battery": unit.battery,
            "predicted_mm": record.predicted_mm,
            "expected_mm": unit.prediction and unit.prediction.expected_mm,
            "cycle_s": record.cycle_s,
            "waited_for_vision_ms": unit.waited_for_vision_ms,
        }
        self._publish(unit_event(unit.id, record.verdict.value, record.sentence, data))
