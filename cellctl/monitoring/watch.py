"""Watches the drift of a taught cell, says when it is found, and corrects it as far as the recipe allows.

All that is known of the drift is written into every unit's record, with the unit and as durably. So it survives a
restart, and it begins anew with every golden assembly, for it is kept under its id. A person may begin anew, too.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ValidationError

from cellctl.assembly.seating import worst_mm
from cellctl.assembly.views import corner_mm
from cellctl.desk.records import latest_kept, number_of, units
from cellctl.geometry import Offset, Pose
from cellctl.journal_file import FILE_NAME
from cellctl.learnt.references import STRICT, Reference, now
from cellctl.log import log
from cellctl.monitoring.drift import Alarm, Cause, Causes, Drift, Observation, Shift, Signal, after, causes, restarted
from cellctl.recipe import Recipe

REMEDIES = {
    Cause.CONSTANT: "Verify the cameras (`cellctl calibrate verify camera-1`) and calibrate what has moved, then teach",
    Cause.TOOL_CENTRE: "Run `cellctl calibrate tool`, then `cellctl teach`",
    Cause.CAMERA_2_SCALE: "Check that the battery is in camera 2's focus, run `cellctl calibrate camera-2`, then teach",
}


class Kept(BaseModel):
    """What a unit's record keeps of the drift: which golden assembly it is counted from, and all that was known."""

    model_config = STRICT
    of: str
    seen: Observation | None  # this unit, if its gap was measured
    known: Drift


class FreshStart(Reference):
    """A person has begun anew: what earlier units say does not count."""

    schema_version: Literal[1] = 1
    after_unit: int  # its number

    @staticmethod
    def path(state: Path, of: str) -> Path:
        """Where the file is."""
        return state / "drift" / f"{of}.json"


@dataclass
class Watch:
    """The drift since one golden assembly, kept up to date unit by unit."""

    of: str  # id of the golden assembly
    recipe: Recipe
    known: Drift

    @classmethod
    def resumed(cls, state: Path, recipe: Recipe, of: str) -> Self:
        """Where the last unit with this golden assembly left off, or from the beginning."""
        last = latest_kept(state / FILE_NAME, "drift", of)
        if last is None or last[0] <= _begins_after(state, of):
            return cls(of, recipe, Drift())
        try:
            return cls(of, recipe, Kept.model_validate_json(last[1]).known)
        except ValidationError as error:
            log.warning(f"drift is watched anew: the record of unit {last[0]} cannot be used", error=str(error))
            return cls(of, recipe, Drift())

    def see(self, seen: Observation) -> None:
        """One more unit; an alarm or a correction is logged."""
        self.known, signal = after(self.known, seen)
        if signal is None or signal.cause in {alarm.cause for alarm in self.known.alarms}:
            return
        wanted = _sum(self.known.correction, signal.shift, -1.0)
        if signal.cause is Cause.CONSTANT and _reach_um(self.recipe, wanted) <= self.recipe.drift.correct_up_to_um:
            self.known = restarted(replace(self.known, correction=wanted))
            log.warning(f"drift corrected: {signal.shift.sentence} taken off, in all {wanted.sentence}")
        else:
            alarm = Alarm(signal.cause, alarm_sentence(signal, causes(self.known)))
            self.known = replace(self.known, alarms=(*self.known.alarms, alarm))
            log.warning(alarm.sentence)

    def corrected(self, base_from_battery: Pose) -> Pose:
        """Where a battery is to be placed in its base, with the correction in force."""
        dx_um, dy_um, dt_mdeg = self.known.correction
        mark = corner_mm(self.recipe.battery)
        at = base_from_battery.point(*mark)
        turned = Pose(at.x_mm + dx_um / 1000, at.y_mm + dy_um / 1000, base_from_battery.t_deg + dt_mdeg / 1000)
        return turned @ Pose(-mark.x_mm, -mark.y_mm, 0.0)

    def record(self, seen: Observation | None) -> dict[str, object]:
        """For the record of a unit, if its gap was measured with what it said."""
        return Kept(of=self.of, seen=seen, known=self.known).model_dump(mode="json")


def alarm_sentence(signal: Signal, by: Causes | None) -> str:
    """What has happened, the evidence, and what to do."""
    if signal.cause is Cause.TOOL_CENTRE and by:
        found = f"batteries lie off the more R is turned: the tool's rotation centre is {by.centre_text} off"
    elif signal.cause is Cause.CAMERA_2_SCALE and by:
        found = f"batteries lie off the more they are off in the cup: camera 2's scale is {by.scale_text} off"
    else:
        found = (
            f"for some {signal.units} units batteries lie {signal.shift.sentence} off where they lay after teaching, "
            "all alike: cameras and robot have moved against each other, or the temperature has changed"
        )
        found += f" (tool centre {by.centre_text}, camera 2's scale {by.scale_text})" if by else ""
    return f"drift: {found}. {REMEDIES[signal.cause]}."


def standing_text(state: Path, recipe: Recipe, of: str) -> str:
    """How it stands with the drift, for people. Reads files."""
    known = Watch.resumed(state, recipe, of).known
    alarms = " ".join(alarm.sentence for alarm in known.alarms) or "none found"
    corrected = "" if known.correction == Shift() else f"; corrected by {known.correction.sentence}"
    return f"{alarms} ({known.units} units looked at{corrected})"


def begin_anew(state: Path, of: str) -> None:
    """Forget what the units so far say about the drift, and its correction."""
    newest = units(state / FILE_NAME, last=1)
    number = number_of(str(newest[0]["unit"])) if newest else 0
    FreshStart(made_at=now(), after_unit=number).save(FreshStart.path(state, of))


def _begins_after(state: Path, of: str) -> int:
    path = FreshStart.path(state, of)
    return FreshStart.read(path, "remove it").after_unit if path.exists() else 0


def _sum(one: Shift, two: Shift, factor: float) -> Shift:
    return Shift(*(a + factor * b for a, b in zip(one, two, strict=True)))


def _reach_um(recipe: Recipe, shift: Shift) -> float:
    """How far the furthest corner of the battery moves."""
    dx_um, dy_um, dt_mdeg = shift
    return 1000 * worst_mm(recipe, Offset(dx_um / 1000, dy_um / 1000, dt_mdeg / 1000))
