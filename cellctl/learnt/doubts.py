"""What makes the cell doubt its calibrations although nobody touched them: a collision, a broken motion, the weather.

A doubt holds for calibrations that were made before it, until they are verified (`cellctl calibrate verify`). The
temperature is what a person reads off a thermometer at the robot; it is believed for some hours and not for ever.
"""

from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from cellctl.faults import NotCalibrated
from cellctl.learnt.references import CAMERAS, Eye, Reference, now

Celsius = Annotated[float, Field(ge=-20, le=60)]


class Doubt(Reference):
    """Something has happened that may have moved a camera, the board or the arm."""

    schema_version: Literal[1] = 1
    why: str
    grave: bool  # a collision: nothing is produced before it is verified
    verified: tuple[str, ...] = ()  # ids of the calibrations that were found to hold afterwards

    @staticmethod
    def path(state: Path, camera: Eye) -> Path:
        """Where the file of this camera is."""
        return state / "calibration" / f"{camera}.doubt.json"

    def about(self, calibration: Reference) -> bool:
        """Whether this calibration is older than the event and has not been verified since."""
        return calibration.made_at < self.made_at and calibration.id not in self.verified

    def sentence(self, camera: Eye) -> str:
        """For people."""
        remedy = f"run `cellctl calibrate verify {camera}`, or calibrate it anew"
        return f"{camera} is to be verified: {self.why} ({self.made}); {remedy}"


class Temperature(Reference):
    """The temperature at the robot, as a person has read it."""

    schema_version: Literal[1] = 1
    celsius: Celsius

    @staticmethod
    def path(state: Path) -> Path:
        """Where the file is."""
        return state / "temperature.json"


def doubt_about(state: Path, camera: Eye) -> Doubt | None:
    """The last event for this camera, None when there was none. A damaged file raises NotCalibrated."""
    path = Doubt.path(state, camera)
    if not path.exists():
        return None
    return Doubt.read(path, f"run `cellctl calibrate verify {camera}`")


def raise_doubt(state: Path, why: str, *, grave: bool, cameras: Sequence[Eye] = CAMERAS) -> None:
    """Mark cameras; a grave event that is not verified yet stays."""
    for camera in cameras:
        try:
            before = doubt_about(state, camera)
        except NotCalibrated:
            before = None
        still_grave = before is not None and before.grave and not before.verified
        doubt = Doubt(made_at=now(), why=before.why if before and still_grave else why, grave=grave or still_grave)
        doubt.save(Doubt.path(state, camera))


def settle_doubt(state: Path, camera: Eye, calibration: Reference) -> None:
    """This calibration was verified: it is doubted no more."""
    try:
        doubt = doubt_about(state, camera)
    except NotCalibrated:
        doubt = Doubt(made_at=now(), why="the note of an event was damaged", grave=True)
    if doubt is not None:
        settled = doubt.model_copy(update={"verified": (*doubt.verified, calibration.id)})
        settled.save(Doubt.path(state, camera))


def temperature_now(state: Path, valid_h: float) -> float | None:
    """What was entered within so many hours, in degrees Celsius; None when nothing was. Raises NotCalibrated."""
    path = Temperature.path(state)
    if not path.exists():
        return None
    entered = Temperature.read(path, "enter it anew with `cellctl calibrate temperature CELSIUS`")
    age = now() - entered.made_at
    return entered.celsius if timedelta(minutes=-1) <= age <= timedelta(hours=valid_h) else None
