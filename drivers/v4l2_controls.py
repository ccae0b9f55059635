"""Exposure, gain and triggers of a V4L2 device, by its controls. Calls block.

The API has no standard trigger. Cameras that have one offer it as controls of their own, which are found by their
names: a trigger mode (a switch, or a list with one entry for software), a trigger source, and a button.
"""

from collections.abc import Iterator

from drivers import v4l2_abi as abi
from drivers.camera import Setup, Trigger
from drivers.errors import Refused
from drivers.v4l2_node import NO_SUCH_REQUEST, Node, asked

MOST_CONTROLS = 512
MOST_CHOICES = 64
MODE_NAMES = ("trigger mode", "triggermode", "trigger enable")
SOURCE_NAMES = ("trigger source", "triggersource")
BUTTON_NAMES = ("software trigger", "trigger software", "single trigger")
OFF_WORDS = ("off", "disabled", "free run", "none")
SOFTWARE_WORDS = ("software", "single")


class Controls:
    """The controls of one device; `name` is the camera's for the operator."""

    def __init__(self, name: str, node: Node) -> None:
        self._name, self._node = name, node
        self._by_number = {control.number: control for control in self._listed()}
        self._by_name = {control.name.lower(): control for control in self._by_number.values()}

    @property
    def all(self) -> list[abi.Control]:
        """Every control that the device lists."""
        return list(self._by_number.values())

    @property
    def has_software_trigger(self) -> bool:
        """Can it be told to take one picture?"""
        return self._named(MODE_NAMES) is not None and self._named(BUTTON_NAMES) is not None

    def set_exposure(self, exposure_us: float) -> float:
        """Set it and turn automatic exposure off; returns what the device says that it has, in us. Raises Refused."""
        if abi.EXPOSURE_ABSOLUTE not in self._by_number:
            raise Refused(self._name, "no exposure", "the device has no control for an exposure time in microseconds")
        self._set_if_there(abi.EXPOSURE_AUTO, abi.EXPOSURE_MANUAL)
        self._set_if_there(abi.EXPOSURE_AUTO_PRIORITY, 0)
        steps = round(exposure_us / abi.EXPOSURE_STEP_US)
        return self._set(abi.EXPOSURE_ABSOLUTE, steps, f"{exposure_us:g} us") * abi.EXPOSURE_STEP_US

    def exposure_us(self) -> float:
        """In force; 0 when the device does not tell."""
        known = abi.EXPOSURE_ABSOLUTE in self._by_number
        return self._get(abi.EXPOSURE_ABSOLUTE) * abi.EXPOSURE_STEP_US if known else 0.0

    def gain_db(self, step_db: float | None) -> float:
        """In force; 0 when the device does not tell, or nobody knows the size of its steps."""
        known = self._by_number.get(abi.GAIN)
        return (self._get(abi.GAIN) - known.minimum) * step_db if known and step_db else 0.0

    def unmirror(self) -> None:
        """See to it that pictures are the way the sensor sees them. Raises Refused."""
        for number in (abi.MIRRORED, abi.UPSIDE_DOWN):
            self._set_if_there(number, 0)

    def set_gain(self, gain_db: float, step_db: float | None) -> float:
        """Set it and turn automatic gain off; returns what the device says that it has, in dB. Raises Refused.

        A device's gain has no unit: its lowest value counts as 0 dB, every step above as `step_db`.
        """
        self._set_if_there(abi.AUTO_GAIN, 0)
        if gain_db and step_db is None:
            detail = f"{gain_db:g} dB cannot be set: the device's gain has no unit, give gain_db_per_step"
            raise Refused(self._name, "gain", detail)
        lowest = self._by_number.get(abi.GAIN)
        if lowest is None:
            if gain_db:
                raise Refused(self._name, "gain", f"the device has no gain, and {gain_db:g} dB are wanted")
            return 0.0
        steps = round(gain_db / step_db) if step_db else 0
        got = self._set(abi.GAIN, lowest.minimum + steps, f"{gain_db:g} dB") - lowest.minimum
        return got * step_db if step_db else float(got)

    def set_trigger(self, trigger: Trigger, setup: Setup) -> None:
        """Let pictures be taken by this. Raises Refused when the device has no such trigger."""
        mode = self._named(MODE_NAMES)
        by_itself = trigger is Trigger.FREE or (trigger is Trigger.SOFTWARE and not self.has_software_trigger)
        if by_itself:
            if mode is not None:
                self._insist(mode.number, self._choice(mode, OFF_WORDS, 0))
            return
        if mode is None:
            raise Refused(self._name, "no trigger", f"the device has no trigger by {trigger}")
        words = SOFTWARE_WORDS if trigger is Trigger.SOFTWARE else (setup.line.lower(), "external", "hardware")
        source = self._named(SOURCE_NAMES)
        if source is not None:
            self._insist(source.number, self._choice(source, words, None))
        self._insist(mode.number, self._choice(mode, words, 1))

    def press(self) -> None:
        """Take one picture."""
        button = self._named(BUTTON_NAMES)
        assert button is not None
        self._node.ioctl(abi.S_CTRL, abi.ask_control(button.number, 1))

    def _named(self, names: tuple[str, ...]) -> abi.Control | None:
        return next((self._by_name[name] for name in names if name in self._by_name), None)

    def _listed(self) -> Iterator[abi.Control]:
        number = 0
        for _ in range(MOST_CONTROLS):
            try:
                control = abi.control_facts(asked(self._node, abi.QUERY_EXT_CTRL, abi.ask_control_after(number)))
            except OSError as error:
                if error.errno in NO_SUCH_REQUEST:
                    return
                raise
            if control.number <= number:
                return  # a device that goes round in circles
            number = control.number
            if not control.flags & abi.DISABLED:
                yield control

    def _choice(self, control: abi.Control, words: tuple[str, ...], otherwise: int | None) -> int:
        """The entry of a list that has one of these words in its name."""
        if control.kind in (abi.MENU, abi.INTEGER_MENU):
            entries = dict(self._choices(control))
            fits = [index for index, entry in entries.items() if any(word in entry.lower() for word in words)]
            if fits:
                return fits[0]
            if otherwise is None:
                known = ", ".join(entries.values())
                raise Refused(self._name, "no trigger", f"{control.name} has no {words[0]}; it has {known}")
        return otherwise if otherwise is not None else 1

    def _choices(self, control: abi.Control) -> Iterator[tuple[int, str]]:
        last = min(control.maximum, control.minimum + MOST_CHOICES)
        for index in range(max(control.minimum, 0), last + 1):
            try:
                yield index, abi.choice_name(asked(self._node, abi.QUERYMENU, abi.ask_choice(control.number, index)))
            except OSError as error:
                if error.errno not in NO_SUCH_REQUEST:  # a list may have holes
                    raise

    def _get(self, number: int) -> int:
        return abi.control_value(asked(self._node, abi.G_CTRL, abi.ask_control(number)))

    def _set_if_there(self, number: int, value: int) -> None:
        if number in self._by_number:
            self._insist(number, value)

    def _insist(self, number: int, value: int) -> None:
        """Set a control to nothing but this. Raises Refused."""
        got = self._set(number, value, str(value))
        if got != value:
            name = self._by_number[number].name
            raise Refused(self._name, "read-back", f"{name} was set to {value} and is {got}")

    def _set(self, number: int, value: int, wanted: str) -> int:
        """Set a control and read it back. Raises Refused when the value is out of the control's range."""
        control = self._by_number[number]
        if not control.minimum <= value <= control.maximum:
            span = f"{control.minimum} to {control.maximum}"
            raise Refused(self._name, "out of range", f"{wanted}: {control.name} goes from {span}, not {value}")
        self._node.ioctl(abi.S_CTRL, abi.ask_control(number, value))
        return self._get(number)
