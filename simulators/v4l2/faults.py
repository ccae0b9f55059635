"""What can be wrong with a simulated V4L2 camera: one verb, `inject`."""

import inspect
from collections import Counter
from collections.abc import Callable
from functools import partial

from simulators.v4l2.controls import EXPOSURE_ABSOLUTE, TRIGGER_MODE
from simulators.v4l2.port import Port


class Faults:
    """The faults in force. Every one is set by `inject`, which refuses what it does not know.

    | fault | parameters | effect |
    |---|---|---|
    | drop | count=1 | the next pictures get lost before they reach a buffer; they are numbered |
    | error_flag | count=1 | the next pictures arrive damaged, with the error flag |
    | wrong_size | count=1 | the next pictures have half of their lines, without the error flag |
    | stale | count=1, alone=False | the previous picture once more, before the true one or instead of it |
    | stuck_sequence | on=True | all pictures have one number |
    | ignore_trigger | count=1 | the next triggers have no effect |
    | freeze | on=True | no more pictures come |
    | stuck_exposure | on=True | a new exposure time is acknowledged and not taken |
    | stuck_trigger | on=True | a new trigger mode is acknowledged and not taken |
    | busy | on=True | another program has the camera |
    | unplug | on=True | the camera is gone; on=False puts it in again |
    | pulse | | the line trigger's input gets one pulse |
    | clear | | all of the above end |
    """

    def __init__(self, port: Port) -> None:
        self._port = port
        self.pulses = 0
        self._left: Counter[str] = Counter()
        self._on: set[str] = set()
        self._stale_alone = False
        self._verbs: dict[str, Callable[..., None]] = {
            "stale": self._stale,
            "stuck_exposure": partial(self._stick, EXPOSURE_ABSOLUTE),
            "stuck_trigger": partial(self._stick, TRIGGER_MODE),
            "busy": self._busy,
            "unplug": self._unplug,
            "pulse": self._pulse,
            "clear": self._clear,
        }
        self._switches = ("stuck_sequence", "freeze")
        self._counted = ("drop", "error_flag", "wrong_size", "ignore_trigger")

    def inject(self, fault: str, **params: object) -> None:
        """Put a fault in force; raises ValueError for an unknown fault or parameter."""
        verb = self._verb(fault)
        try:
            inspect.signature(verb).bind(**params)
        except TypeError as error:
            raise ValueError(f"camera fault {fault!r}: {error}") from error
        verb(**params)

    def _verb(self, fault: str) -> Callable[..., None]:
        if fault in self._switches:
            return lambda on=True: self._switch(fault, on)
        if fault in self._counted:
            return lambda count=1: self._count(fault, count)
        if fault not in self._verbs:
            known = ", ".join(sorted([*self._verbs, *self._switches, *self._counted]))
            raise ValueError(f"a V4L2 camera has no fault {fault!r}; it has {known}")
        return self._verbs[fault]

    def _switch(self, fault: str, on: bool) -> None:
        self._on = self._on | {fault} if on else self._on - {fault}

    def _count(self, fault: str, count: int) -> None:
        self._left[fault] = count

    def _stale(self, count: int = 1, alone: bool = False) -> None:
        self._left["stale"] = count
        self._stale_alone = alone

    def _stick(self, control: int, on: bool = True) -> None:
        controls = self._port.device.controls
        controls.stuck = controls.stuck | {control} if on else controls.stuck - {control}

    def _busy(self, on: bool = True) -> None:
        self._port.device.foreign = on

    def _unplug(self, on: bool = True) -> None:
        self._port.unplug(on)

    def _pulse(self) -> None:
        self.pulses += 1
        for wake in self._port.wakes:
            wake()

    def _clear(self) -> None:
        self._left.clear()
        self._on.clear()
        self._stale_alone = False
        self._port.device.controls.stuck = frozenset()
        self._busy(False)
        self._unplug(False)

    def on(self, fault: str) -> bool:
        """Is this switch set?"""
        return fault in self._on

    def take(self, fault: str) -> bool:
        """True so many times as the fault was injected for."""
        if self._left[fault] <= 0:
            return False
        self._left[fault] -= 1
        return True

    def stale(self) -> tuple[bool, bool]:
        """(deliver the previous picture now, deliver the true one too)."""
        stale = self.take("stale")
        return stale, not (stale and self._stale_alone)
