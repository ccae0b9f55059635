"""The controls of a simulated V4L2 camera: exposure, gain, trigger. Pure."""

import errno
from dataclasses import dataclass

from simulators.v4l2 import abi
from simulators.v4l2.abi import ControlType

AUTO_GAIN, GAIN, MIRRORED, UPSIDE_DOWN = 0x00980912, 0x00980913, 0x00980914, 0x00980915
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, EXPOSURE_AUTO_PRIORITY = 0x009A0901, 0x009A0902, 0x009A0903
PRIVATE = 0x00981900  # first of a driver's own controls: triggers have no standard ones
TRIGGER_MODE, TRIGGER_SOURCE, SOFTWARE_TRIGGER = PRIVATE, PRIVATE + 1, PRIVATE + 2
MANUAL, APERTURE_PRIORITY = 1, 3
EXPOSURE_STEP_US = 100.0
GAIN_STEP_DB = 0.1
ID_MASK = 0x0FFFFFFF


@dataclass(slots=True)
class Control:
    """One control and its value."""

    id: int
    name: str
    kind: ControlType
    minimum: int
    maximum: int
    step: int
    default: int
    menu: tuple[str, ...] = ()
    value: int = 0

    def __post_init__(self) -> None:
        self.value = self.default

    @property
    def flags(self) -> int:
        """What kind of thing it is to write it."""
        return abi.EXECUTE_ON_WRITE if self.kind is ControlType.BUTTON else 0


def _imaging() -> list[Control]:
    automatic = ("Auto Mode", "Manual Mode", "Shutter Priority Mode", "Aperture Priority Mode")
    return [
        Control(AUTO_GAIN, "Gain, Automatic", ControlType.BOOLEAN, 0, 1, 1, 1),
        Control(GAIN, "Gain", ControlType.INTEGER, 0, 240, 1, 0),
        Control(MIRRORED, "Horizontal Flip", ControlType.BOOLEAN, 0, 1, 1, 0),
        Control(UPSIDE_DOWN, "Vertical Flip", ControlType.BOOLEAN, 0, 1, 1, 0),
        Control(EXPOSURE_AUTO, "Auto Exposure", ControlType.MENU, 0, 3, 1, APERTURE_PRIORITY, automatic),
        Control(EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", ControlType.INTEGER, 1, 10000, 1, 20),
        Control(EXPOSURE_AUTO_PRIORITY, "Exposure, Dynamic Framerate", ControlType.BOOLEAN, 0, 1, 1, 1),
    ]


def _triggers() -> list[Control]:
    return [
        Control(TRIGGER_MODE, "Trigger Mode", ControlType.BOOLEAN, 0, 1, 1, 0),
        Control(TRIGGER_SOURCE, "Trigger Source", ControlType.MENU, 0, 1, 1, 0, ("Line0", "Software")),
        Control(SOFTWARE_TRIGGER, "Software Trigger", ControlType.BUTTON, 0, 0, 0, 0),
    ]


class Controls:
    """All of them, by number. Refusals are OSError with the number that the kernel would give."""

    def __init__(self, *, triggers: bool) -> None:
        controls = _imaging() + (_triggers() if triggers else [])
        self._by_id = {control.id: control for control in controls}
        self.presses = 0  # of the software trigger, so far
        self.stuck: frozenset[int] = frozenset()  # these acknowledge a new value and do not take it

    def find(self, number: int) -> Control:
        """The control, or with NEXT_CONTROL set the first one after it; EINVAL."""
        if number & (abi.NEXT_CONTROL | abi.NEXT_COMPOUND):
            return self._after(number)
        if number not in self._by_id:
            raise OSError(errno.EINVAL, f"no control {number:#x}")
        return self._by_id[number]

    def _after(self, number: int) -> Control:
        later = [known for known in sorted(self._by_id) if known > number & ID_MASK]
        if not later or not number & abi.NEXT_CONTROL:  # there are no compound ones
            raise OSError(errno.EINVAL, "no further control")
        return self._by_id[later[0]]

    def describe(self, data: bytes) -> bytes:
        """VIDIOC_QUERYCTRL."""
        control = self.find(abi.NUMBER.unpack_from(data)[0])
        return abi.QUERY_CONTROL.pack(*_described(control), control.flags)

    def describe_at_length(self, data: bytes) -> bytes:
        """VIDIOC_QUERY_EXT_CTRL."""
        control = self.find(abi.NUMBER.unpack_from(data)[0])
        return abi.QUERY_EXT_CONTROL.pack(*_described(control), control.flags, 4, 1, 0, b"")

    def describe_choice(self, data: bytes) -> bytes:
        """VIDIOC_QUERYMENU."""
        number, index, _name = abi.QUERY_MENU.unpack(data)
        choices = self.find(number & ID_MASK).menu
        if index >= len(choices):
            raise OSError(errno.EINVAL, f"no choice {index}")
        return abi.QUERY_MENU.pack(number, index, abi.text(choices[index], 32))

    def get(self, data: bytes) -> bytes:
        """VIDIOC_G_CTRL; EACCES for a button, which has no value."""
        control = self.find(abi.CONTROL.unpack(data)[0] & ID_MASK)
        if control.kind is ControlType.BUTTON:
            raise OSError(errno.EACCES, f"{control.name} cannot be read")
        return abi.CONTROL.pack(control.id, control.value)

    def set(self, data: bytes) -> bytes:
        """VIDIOC_S_CTRL: a value, rounded to a step; ERANGE outside of its limits."""
        number, value = abi.CONTROL.unpack(data)
        control = self.find(number & ID_MASK)
        if control.kind is ControlType.BUTTON:
            self.presses += 1
        else:
            self._take(control, value)
        return abi.CONTROL.pack(control.id, control.value)

    def _take(self, control: Control, value: int) -> None:
        if not control.minimum <= value <= control.maximum:
            raise OSError(errno.ERANGE, f"{control.name} goes from {control.minimum} to {control.maximum}")
        if control.id not in self.stuck:
            control.value = value - (value - control.minimum) % control.step

    def _value(self, number: int) -> int:
        return self._by_id[number].value if number in self._by_id else 0

    @property
    def exposure_us(self) -> float:
        """In force. Automatic exposure is not simulated: it stays at the set time."""
        return self._value(EXPOSURE_ABSOLUTE) * EXPOSURE_STEP_US

    @property
    def gain_db(self) -> float:
        """In force."""
        return self._value(GAIN) * GAIN_STEP_DB

    @property
    def flips(self) -> tuple[bool, bool]:
        """Is the picture mirrored left to right, top to bottom?"""
        return bool(self._value(MIRRORED)), bool(self._value(UPSIDE_DOWN))

    @property
    def trigger(self) -> str:
        """What begins an exposure: "free" (the camera itself), "line" or "software"."""
        if not self._value(TRIGGER_MODE):
            return "free"
        return "software" if self._value(TRIGGER_SOURCE) else "line"


def _described(control: Control) -> tuple[int, int, bytes, int, int, int, int]:
    limits = control.minimum, control.maximum, control.step
    return control.id, control.kind, abi.text(control.name, 32), *limits, control.default
