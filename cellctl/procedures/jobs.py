"""What calibration, verification, hysteresis test and teaching have in common: a job for Execute in Maintenance."""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from cellctl.assembly.hand import Hand, seeing
from cellctl.calibration.errors import CalibrationError
from cellctl.control.events import Event, job_event, progress_event
from cellctl.faults import CalibrationFailed, CellError
from cellctl.log import log
from cellctl.recipe import Recipe
from drivers.errors import DeviceError


class Outcome(NamedTuple):
    """How a job went well: one sentence, and figures for programs."""

    text: str
    result: Mapping[str, object] = {}


@dataclass(frozen=True)
class Job:
    """One job: its name for those who watch, what it works with, and where its news go."""

    name: str
    recipe: Recipe  # for exposure and motion
    hand: Hand
    publish: Callable[[Event], None]
    empties_first: bool = True  # what hangs on the cup or stands at the station is put away

    def say(self, text: str) -> None:
        """News on the way."""
        log.info(f"{self.name}: {text}")
        self.publish(progress_event(self.name, text))

    def table(self, rows: list[str]) -> None:
        """A table for the person who waits."""
        for row in rows:
            self.say(row)

    async def run(self, work: Callable[[], Awaitable[Outcome]]) -> None:
        """With light and the recipe's exposures; the end is told to everybody who watches, good or bad.

        Raises CellError (CalibrationFailed with the check that failed and its figures), DeviceError.
        """
        try:
            async with seeing(self.hand.devices, self.recipe):
                if self.empties_first:
                    await self.hand.clear_away()
                outcome = await work()
        except CalibrationError as error:
            self.publish(job_event(self.name, False, str(error)))
            raise CalibrationFailed(str(error)) from error
        except (CellError, DeviceError) as error:
            self.publish(job_event(self.name, False, str(error)))
            raise
        log.info(outcome.text)
        self.publish(job_event(self.name, True, outcome.text, outcome.result))
