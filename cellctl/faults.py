"""Everything that can stop the cell, what the cell does about it, and what the operator reads.

One row per exception class; a test proves that no class is missing and no row is left over. Two trees: causes on
the wire are in drivers/errors.py, causes in the work are here.
"""

from enum import StrEnum
from typing import NamedTuple

from drivers.errors import (
    Collision,
    DeviceError,
    Disturbed,
    FrameLost,
    Garbled,
    LinkLost,
    Mismatch,
    NoAnswer,
    Refused,
    Unavailable,
)


class CellError(Exception):
    """The devices worked but the work did not. The text is the evidence."""


class SafetyLost(CellError):
    """Emergency stop, guard, air or robot enable fell, now or in a short moment that was latched."""


class NotReady(CellError):
    """Something that must be so before the robot may move is not so."""


class NotCalibrated(CellError):
    """There is no valid calibration or no taught reference for what was asked."""


class CalibrationFailed(CellError):
    """The calibration was carried out but its result is not good enough to be used."""


class NoParts(CellError):
    """No base or no battery came in time."""


class BaseNotFound(CellError):
    """Camera 1 saw no base it can trust."""


class BatteryNotFound(CellError):
    """Camera 2 saw no battery it can trust."""


class OffsetTooLarge(CellError):
    """A part lies further from its taught place than the recipe allows."""


class PlacementUncertain(CellError):
    """The predicted placement error is larger than the recipe allows."""


class GapNotSeen(CellError):
    """Camera 1 could not measure how the battery lies in its seat."""


class GapOutside(CellError):
    """The battery lies in its seat, but not as it must."""


class FormulasDisagree(CellError):
    """The two independent forms of the correction do not give the same place: the program cannot be trusted."""


class PickFailed(CellError):
    """The cup came up empty."""


class BatteryLost(CellError):
    """The battery left the cup before it was placed."""


class CarrierMoved(CellError):
    """The carrier is not where camera 1 saw its base: unclamped, or on a belt that moves."""


class VacuumStuck(CellError):
    """The vacuum switch reports a part where there can be none, or the part does not let go."""


class UnitTooSlow(CellError):
    """A unit was not finished within the time that the recipe gives it."""


class RecordLost(CellError):
    """The unit's record could not be written; no unit goes on without its record."""


class Reaction(StrEnum):
    """What the cell does on its own, from mildest to hardest."""

    REJECT = "reject"  # this unit is rejected, the next one is started
    SUSPEND = "suspend"  # wait for parts, then go on
    HOLD = "hold"  # stand still, wait for a person
    ABORT = "abort"  # stop everything; motion only after Clear and Reset


class Fault(NamedTuple):
    """One row of the table: stable code, reaction, what to do."""

    code: str
    reaction: Reaction
    remedy: str


FAULTS: dict[type[Exception], Fault] = {
    LinkLost: Fault("D1", Reaction.ABORT, "Check the device's power and cable, then Clear and Reset."),
    NoAnswer: Fault(
        "D2", Reaction.ABORT, "Check that the device is in automatic mode and not busy, then Clear and Reset."
    ),
    Garbled: Fault("D3", Reaction.ABORT, "Check cable, baud rate and shielding, then Clear and Reset. Keep the log."),
    Refused: Fault(
        "D4", Reaction.ABORT, "Look the device's code up in its manual, remove the cause, then Clear and Reset."
    ),
    Collision: Fault(
        "D8",
        Reaction.ABORT,
        "Look what the arm hit, then Clear and Reset, and verify the cameras: `cellctl calibrate verify camera-1`.",
    ),
    Disturbed: Fault(
        "D9",
        Reaction.ABORT,
        "Find out who moved the arm: pendant, a robot program, another computer. Then Clear and Reset.",
    ),
    Mismatch: Fault(
        "D5", Reaction.ABORT, "The configuration and the device do not belong together: correct the one that is wrong."
    ),
    FrameLost: Fault(
        "D6", Reaction.REJECT, "Run `cellctl camera check` if it happens again: network card, rmem, MTU, cable."
    ),
    Unavailable: Fault("D7", Reaction.ABORT, "Install the named package, then restart the service."),
    SafetyLost: Fault(
        "S1", Reaction.ABORT, "Release the emergency stop, close the guard, mend what is named, then Clear and Reset."
    ),
    NotReady: Fault("S2", Reaction.ABORT, "Bring the device into the state that is named, then Clear and Reset."),
    NotCalibrated: Fault("C1", Reaction.HOLD, "Stop and Reset, then calibrate the cameras and teach the recipe."),
    CalibrationFailed: Fault(
        "C2", Reaction.HOLD, "Clean the dot plate, check that it lies flat, then Unhold to calibrate again, or Stop."
    ),
    NoParts: Fault("P1", Reaction.SUSPEND, "Check the infeed; the cell goes on with Unsuspend."),
    PickFailed: Fault("P2", Reaction.HOLD, "Check battery table, cup and vacuum, take the battery away, then Unhold."),
    BatteryLost: Fault("P3", Reaction.HOLD, "Find the battery and take it out of the cell, then Unhold."),
    VacuumStuck: Fault("P4", Reaction.HOLD, "Check vacuum switch and cup, take away what hangs on it, then Unhold."),
    BaseNotFound: Fault("V1", Reaction.REJECT, "Check carrier and lens of camera 1 if it happens again."),
    BatteryNotFound: Fault("V2", Reaction.REJECT, "Check cup and lens of camera 2 if it happens again."),
    OffsetTooLarge: Fault("V3", Reaction.REJECT, "Check carrier, table and recipe limits if it happens again."),
    PlacementUncertain: Fault("V4", Reaction.REJECT, "Check lens, light and calibration if it happens again."),
    GapNotSeen: Fault("V5", Reaction.REJECT, "Look whether the battery lies in its seat; clean camera 1's lens."),
    GapOutside: Fault("V6", Reaction.REJECT, "Take the unit apart. If it happens again, see `cellctl drift`."),
    CarrierMoved: Fault(
        "P6", Reaction.HOLD, "Look at belt and clamp, take the battery off the cup and the base out, then Unhold."
    ),
    UnitTooSlow: Fault("P5", Reaction.HOLD, "Look what held it up, take its battery out of the cell, then Unhold."),
    FormulasDisagree: Fault("X2", Reaction.ABORT, "Software error. Keep the log; do not go on with this version."),
    RecordLost: Fault("R1", Reaction.ABORT, "Make room on the disk or replace it, then restart the service."),
}
UNKNOWN = Fault("X1", Reaction.ABORT, "Software error. Keep the log, then Clear and Reset.")


def fault_for(error: BaseException) -> Fault:
    """The row for this error; rows are looked up along the class's ancestors."""
    for kind in type(error).__mro__:
        if kind in FAULTS:
            return FAULTS[kind]
    return UNKNOWN


def sentence(error: BaseException) -> str:
    """What the operator reads: what happened, the evidence, what to do."""
    fault = fault_for(error)
    what = str(error) if isinstance(error, CellError | DeviceError) else f"{type(error).__name__}: {error}"
    return f"[{fault.code}] {what.rstrip('.')}. {fault.remedy}"
