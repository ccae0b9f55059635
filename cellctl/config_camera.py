"""One camera in cell.toml: how it is reached, what part of its sensor is used, its lens."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from cellctl.config_values import Serial, ipv4
from cellctl.mount import Part
from cellctl.strict_toml import Contradiction, Settings
from drivers.camera import Region
from drivers.pixels import BY_NAME, MONO8

FOLDER = "file:"
JPEG = "MJPG"  # not a layout of pixels, so drivers.pixels does not have it
View = Annotated[int, Field(ge=64, le=20000)]
Offset = Annotated[int, Field(ge=0, le=20000)]


def _below_the_file(text: object, info: ValidationInfo) -> object:
    """A folder of pictures counts from the folder of the file that names it."""
    if not isinstance(text, str) or not text.startswith(FOLDER):
        return text
    folder = (info.context or {}).get("folder", "")
    return FOLDER + os.path.normpath(Path(folder, text.removeprefix(FOLDER)))


def _pixel_format(name: str) -> str:
    if name not in BY_NAME and name != JPEG:
        raise ValueError(f"must be one of {', '.join(BY_NAME)}, {JPEG}")
    return name


class CameraConfig(Settings):
    """One camera with its lens."""

    driver: Literal["gige", "v4l2", "files"] = Field(
        description="How the camera is spoken to: GigE Vision, V4L2 = a device node of the kernel (USB, MIPI), "
        "or files = the pictures of a folder instead of a camera"
    )
    address: Annotated[str, BeforeValidator(_below_the_file)] = Field(
        description="IPv4 address of the camera (gige), /dev/videoN (v4l2), file:FOLDER (files)"
    )
    serial: Serial = Field(description="Serial number, as on the camera's label")
    mm_per_px: float = Field(ge=0.0005, le=0.2, description="Nominal size of a pixel on the part in mm")
    view_width_px: View = Field(description="Width of the picture in px")
    view_height_px: View = Field(description="Height of the picture in px")
    view_left_px: Offset = Field(default=0, description="Left edge of the picture on the sensor in px")
    view_top_px: Offset = Field(default=0, description="Upper edge of the picture on the sensor in px")
    pixel_format: Annotated[str, AfterValidator(_pixel_format)] = Field(
        default=MONO8.name, description="What the camera sends; deeper formats are brought to 8 bit over their range"
    )
    packet_delay_us: float = Field(
        default=0.0, ge=0, le=1000, description="A GigE camera waits so long after each packet, for another on its wire"
    )
    gain_db_per_step: float | None = Field(
        default=None, gt=0, le=10, description="One step of a V4L2 camera's gain in dB, from its data sheet"
    )
    lens: Literal["telecentric", "pinhole"] = Field(
        default="telecentric", description="Model of the lens: telecentric, or pinhole for an ordinary one"
    )

    @property
    def region(self) -> Region:
        """The part of the sensor that is used."""
        return Region(self.view_left_px, self.view_top_px, self.view_width_px, self.view_height_px)

    @property
    def folder(self) -> Path:
        """Of the pictures that stand for a camera."""
        return Path(self.address.removeprefix(FOLDER))

    def contradictions(self) -> Iterator[Contradiction]:
        """The address is one that the driver takes, and no key is of another driver."""
        yield from self._address_objections()
        if self.driver != "v4l2":
            if self.pixel_format == JPEG:
                yield "pixel_format", f"{JPEG} is for the driver v4l2"
            if self.gain_db_per_step is not None:
                yield "gain_db_per_step", "is for the driver v4l2: other cameras tell their gain in dB"
        if self.driver != "gige" and self.packet_delay_us:
            yield "packet_delay_us", "is for the driver gige"

    def _address_objections(self) -> Iterator[Contradiction]:
        if self.driver == "v4l2":
            if not Path(self.address).is_absolute() or "\0" in self.address:
                yield "address", "must be a device node such as /dev/video0 for the driver v4l2"
        elif self.driver == "files":
            if len(self.address) <= len(FOLDER) or not self.address.startswith(FOLDER):
                yield "address", f"must be {FOLDER}FOLDER, a folder of PNG or TIFF pictures, for the driver files"
        else:
            try:
                ipv4(self.address)
            except ValueError as error:
                yield "address", str(error)


class RobotCameraConfig(CameraConfig):
    """Camera 1, which travels with the robot."""

    mount: Part = Field(description="What carries camera 1: the tool (turns with R) or the second arm, arm_2")
