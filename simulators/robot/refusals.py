"""What the controller refuses, in the order in which it says so. Pure: one table over one situation."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Flag, auto
from typing import NamedTuple

from simulators.robot.codes import Code
from simulators.robot.modes import Mode


class Kind(Flag):
    """What a client or a program wants."""

    MOTION = auto()  # a client's move
    JOG = auto()
    STEP = auto()  # a program's move
    POWER_ON = auto()
    POWER_OFF = auto()
    ALARM_RESET = auto()
    SETTING = auto()
    MODE = auto()
    OUTPUT = auto()  # outputs and variables: how a client and a running program talk
    PROGRAM = auto()  # load, write, select
    RUN = auto()
    RESET = auto()


MOVES = Kind.MOTION | Kind.JOG | Kind.STEP
ACTS = MOVES | Kind.POWER_ON | Kind.RUN
ONLINE = ~Kind.STEP


@dataclass(frozen=True, slots=True)
class Situation:
    """The controller at this moment. `servo` and `origin` are those of the axes that shall move."""

    emergency: bool
    alarm: Code | None
    mode: Mode
    modes_that_move: tuple[Mode, ...]
    interlocked: bool
    arm_locked: bool
    moving: bool
    operating: bool
    running: bool
    motor: bool
    servo: bool
    origin: bool


class Reason(NamedTuple):
    """Why something of these kinds is refused, when it is."""

    kinds: Kind
    applies: Callable[[Situation], bool]
    code: Code


ORDER: tuple[Reason, ...] = (
    Reason(ACTS | Kind.ALARM_RESET, lambda now: now.emergency, Code.EMERGENCY_STOP),
    Reason(ACTS, lambda now: now.alarm is not None, Code.WHILE_ALARM),
    Reason(ONLINE, lambda now: now.mode in (Mode.HELD, Mode.RESTRICTED), Code.CONTROL_RIGHT),
    Reason(Kind.MOTION, lambda now: now.mode not in now.modes_that_move, Code.MODE),
    Reason(Kind.RUN, lambda now: now.mode is not Mode.AUTO, Code.MODE),
    Reason(MOVES | Kind.RUN, lambda now: now.interlocked, Code.INTERLOCK),
    Reason(MOVES | Kind.RUN, lambda now: now.arm_locked, Code.ARM_LOCKED),
    Reason(ONLINE & ~Kind.OUTPUT, lambda now: now.moving, Code.MOVING),
    Reason(ONLINE & ~Kind.OUTPUT, lambda now: now.operating, Code.OPERATING),
    Reason(ONLINE & ~Kind.OUTPUT & ~Kind.POWER_OFF, lambda now: now.running, Code.PROGRAM_BUSY),
    Reason(MOVES, lambda now: not now.motor, Code.MOTOR_OFF),
    Reason(MOVES, lambda now: not now.servo, Code.SERVO_OFF),
    Reason(Kind.MOTION | Kind.STEP, lambda now: not now.origin, Code.ORIGIN_INCOMPLETE),
)


def refusal(kind: Kind, now: Situation) -> Code | None:
    """The first reason against it, None when there is none."""
    return next((reason.code for reason in ORDER if kind in reason.kinds and reason.applies(now)), None)
