"""Frames, function blocks, and the standard function blocks with their timing. Pure.

A frame is one instance's memory: its time base, then its variables in the order of the block's slots, then what no
program can name. Behaviour after IEC 61131-3:2013 tables 43..46 (bistables, edges, counters, timers).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from simulators.st.errors import Spot
from simulators.st.types import BOOL, INT, TIME, Type

Frame = list[Any]
Run = Callable[[Frame], Any]
NOWHERE = Spot(1, 1)  # in no program, or in no place of it


@dataclass(slots=True)
class TimeBase:
    """The clock that timers look at; set by whoever runs the program, before each scan."""

    now_us: int = 0


@dataclass(frozen=True, slots=True)
class Slot:
    """One variable in the frames of a block. `constant` has its value where it never changes."""

    at: int
    name: str
    type: "Type | Block"
    section: str
    initial: int | bool = 0
    constant: int | bool | None = None
    retain: bool = False
    address: str = ""
    spot: Spot = NOWHERE


@dataclass(frozen=True, slots=True)
class Block:
    """A function block, or the program: what its frames hold and what one call does."""

    name: str
    slots: dict[str, Slot]  # by name in small letters
    step: Callable[[Frame], None]
    hidden: tuple[Any, ...] = field(default=())

    def frame(self, time: TimeBase, time_of: Mapping[str, TimeBase], path: str = "") -> Frame:
        """A new instance; `time_of` gives the instances at these paths, and what is in them, a time of their own."""
        made: Frame = [time]
        for name, slot in self.slots.items():
            inner = f"{path}{name}"
            if isinstance(slot.type, Block):
                made.append(slot.type.frame(time_of.get(inner, time), time_of, f"{inner}."))
            else:
                made.append(slot.initial)
        return made + list(self.hidden)


def _standard(
    name: str, inputs: dict[str, Type], outputs: dict[str, Type], step: Callable[[Frame], None], *hidden: Any
) -> Block:
    sections = [("VAR_INPUT", inputs), ("VAR_OUTPUT", outputs)]
    flat = [(variable, kind, section) for section, of in sections for variable, kind in of.items()]
    slots = {
        variable.lower(): Slot(at, variable, kind, section, False if kind is BOOL else 0)
        for at, (variable, kind, section) in enumerate(flat, 1)
    }
    return Block(name, slots, step, hidden)


def _ton(frame: Frame) -> None:
    """[time, IN, PT, Q, ET, since]: Q follows IN when that has been on for PT."""
    if not frame[1]:
        frame[3], frame[4], frame[5] = False, 0, None
        return
    now_us = frame[0].now_us
    if frame[5] is None:
        frame[5] = now_us
    frame[4] = min(now_us - frame[5], frame[2])
    frame[3] = frame[4] >= frame[2]


def _tof(frame: Frame) -> None:
    """[time, IN, PT, Q, ET, since]: Q stays for PT after IN has gone."""
    if frame[1]:
        frame[3], frame[4], frame[5] = True, 0, None
    elif frame[3]:
        now_us = frame[0].now_us
        if frame[5] is None:
            frame[5] = now_us
        frame[4] = min(now_us - frame[5], frame[2])
        frame[3] = frame[4] < frame[2]


def _tp(frame: Frame) -> None:
    """[time, IN, PT, Q, ET, since, IN before]: one pulse of length PT, whatever IN does meanwhile."""
    now_us = frame[0].now_us
    if frame[3]:
        frame[4] = min(now_us - frame[5], frame[2])
        frame[3] = frame[4] < frame[2]
    if frame[1] and not frame[6] and not frame[3]:
        frame[3], frame[4], frame[5] = frame[2] > 0, 0, now_us
    elif not frame[1] and not frame[3]:
        frame[4] = 0
    frame[6] = frame[1]


def _r_trig(frame: Frame) -> None:
    """[time, CLK, Q, CLK before]."""
    frame[2], frame[3] = frame[1] and not frame[3], frame[1]


def _f_trig(frame: Frame) -> None:
    """[time, CLK, Q, CLK before]."""
    frame[2], frame[3] = frame[3] and not frame[1], frame[1]


def _rs(frame: Frame) -> None:
    """[time, S, R1, Q1]: reset wins."""
    frame[3] = not frame[2] and (frame[1] or frame[3])


def _sr(frame: Frame) -> None:
    """[time, S1, R, Q1]: set wins."""
    frame[3] = frame[1] or (not frame[2] and frame[3])


def _ctu(frame: Frame) -> None:
    """[time, CU, R, PV, Q, CV, CU before]: counts rising edges up to the end of INT."""
    if frame[2]:
        frame[5] = 0
    elif frame[1] and not frame[6] and frame[5] < 32767:
        frame[5] += 1
    frame[4], frame[6] = frame[5] >= frame[3], frame[1]


_TIMER = ({"IN": BOOL, "PT": TIME}, {"Q": BOOL, "ET": TIME})
STANDARD_BLOCKS = {
    block.name.lower(): block
    for block in (
        _standard("TON", *_TIMER, _ton, None),
        _standard("TOF", *_TIMER, _tof, None),
        _standard("TP", *_TIMER, _tp, None, False),
        _standard("R_TRIG", {"CLK": BOOL}, {"Q": BOOL}, _r_trig, False),
        _standard("F_TRIG", {"CLK": BOOL}, {"Q": BOOL}, _f_trig, False),
        _standard("RS", {"S": BOOL, "R1": BOOL}, {"Q1": BOOL}, _rs),
        _standard("SR", {"S1": BOOL, "R": BOOL}, {"Q1": BOOL}, _sr),
        _standard("CTU", {"CU": BOOL, "R": BOOL, "PV": INT}, {"Q": BOOL, "CV": INT}, _ctu, False),
    )
}
