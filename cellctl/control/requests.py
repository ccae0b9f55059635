"""What may be asked over the control socket, one model per verb. Strict: a key or type that is not here is refused."""

import textwrap
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from cellctl.machine import Command, Mode

VERSION = 1
MAX_LINE = 64 * 1024
LONGEST_SENTENCE = 300
Camera = Literal["camera-1", "camera-2"]


class BadRequest(Exception):
    """This line is no request; the text says where and why."""


class _Request(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")
    version: Literal[1]


class StatusRequest(_Request):
    """How is the cell."""

    verb: Literal["status"]


class CommandRequest(_Request):
    """A PackML command."""

    verb: Literal["command"]
    name: Literal[
        "reset", "start", "stop", "hold", "unhold", "suspend", "unsuspend", "abort", "clear", "complete"
    ]  # fmt: skip

    @property
    def command(self) -> Command:
        """The command that is meant."""
        return Command[self.name.upper()]


class ModeRequest(_Request):
    """Change what the cell may be used for."""

    verb: Literal["mode"]
    name: Literal["production", "maintenance", "manual"]

    @property
    def mode(self) -> Mode:
        """The mode that is meant."""
        return Mode[self.name.upper()]


class RecipeUseRequest(_Request):
    """Work with this recipe from the next start on."""

    verb: Literal["recipe_use"]
    name: Annotated[str, Field(pattern=r"^[a-z0-9-]{1,64}$")]


class CalibrateRequest(_Request):
    """Run a calibration; a job that reports through `watch`."""

    verb: Literal["calibrate"]
    what: Literal["camera-1", "camera-2", "tool"]


class VerifyRequest(_Request):
    """Find out whether a calibration still holds; a job that reports through `watch`."""

    verb: Literal["verify"]
    camera: Camera


class HysteresisRequest(_Request):
    """Find out how stops differ with the side they are approached from; a job that reports through `watch`."""

    verb: Literal["hysteresis"]
    repeats: Annotated[int, Field(ge=2, le=50)]


class CalibrationUseRequest(_Request):
    """Use another version of a calibration from the next start on: a waiting candidate, an earlier version."""

    verb: Literal["calibration_use"]
    camera: Camera
    what: Literal["accept", "revert"]
    calibration: Annotated[str, Field(pattern=r"^[0-9a-f]{12}$")] | None  # its id; None = the newest that waits


class TemperatureRequest(_Request):
    """The temperature at the robot, as a person has read it."""

    verb: Literal["temperature"]
    celsius: Annotated[float, Field(ge=-20, le=60)]


class TeachRequest(_Request):
    """Teach the recipe in use with golden assemblies; a job that reports through `watch`."""

    verb: Literal["teach"]
    repeats: Annotated[int, Field(ge=1, le=100)]
    pairs: Annotated[int, Field(ge=1, le=20)]


class DriftAnewRequest(_Request):
    """Forget what was found about the drift of the recipe in use, and its correction."""

    verb: Literal["drift_anew"]


class ProceedRequest(_Request):
    """A person has done what the running job asked for."""

    verb: Literal["proceed"]


class UnitsLeftRequest(_Request):
    """How many units the next production run makes; 0 = until it is stopped."""

    verb: Literal["units_left"]
    count: Annotated[int, Field(ge=0, le=1_000_000)]


class PlcRequest(_Request):
    """The PLC's register map as the daemon sees it, and so many of the last packets on the wire."""

    verb: Literal["plc"]
    packets: Annotated[int, Field(ge=0, le=400)]


class WatchRequest(_Request):
    """Stream events until the connection is closed."""

    verb: Literal["watch"]


Request = (
    StatusRequest
    | CommandRequest
    | ModeRequest
    | RecipeUseRequest
    | CalibrateRequest
    | VerifyRequest
    | HysteresisRequest
    | CalibrationUseRequest
    | TemperatureRequest
    | TeachRequest
    | DriftAnewRequest
    | ProceedRequest
    | UnitsLeftRequest
    | PlcRequest
)
"""What a handler is asked. `watch` is answered by the server itself."""

_LINE: TypeAdapter[Request | WatchRequest] = TypeAdapter(Annotated[Request | WatchRequest, Field(discriminator="verb")])


def parse_request(line: bytes) -> Request | WatchRequest:
    """One line as a request. Raises BadRequest for everything that is not exactly one."""
    if len(line) > MAX_LINE:
        raise BadRequest(f"the line is longer than {MAX_LINE} bytes")
    try:
        return _LINE.validate_json(line)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        got = "" if first["type"] in ("missing", "json_invalid") else f" (got {first['input']!r:.60})"
        raise BadRequest(_sentence(f"{where + ': ' if where else ''}{first['msg']}{got}")) from None


def _sentence(text: str) -> str:
    """On one line, and no longer than a person reads, whatever was sent."""
    return textwrap.shorten(text, LONGEST_SENTENCE, placeholder=" ...")
