"""What can be made to go wrong with the robot itself, as a person, a wall or age does it; `faults` are the line's."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from simulators.moves import Line, Plan
from simulators.robot.codes import Code
from simulators.robot.modes import Mode
from simulators.robot.targets import changed
from simulators.scara import ToolPose, Unreachable
from simulators.ways import Pace

if TYPE_CHECKING:
    from simulators.robot.machine import Machine

PENDANT_PACE = Pace(0.1)


class Mishaps:
    """The verbs that `inject` finds here by name. Lengths in mm, angles in degrees."""

    def __init__(self, machine: "Machine") -> None:
        self._machine = machine
        self._alarm_on_way: tuple[Code, float] | None = None
        self._blocked_z_mm: float | None = None
        self._watched: Plan | None = None
        self.later: Callable[[float, Callable[[], None]], None] = lambda for_s, do: None

    def verbs(self) -> dict[str, Callable[..., None]]:
        """By name."""
        return {
            "alarm": self.alarm,
            "mode": self.mode,
            "servo_off": self.servo_off,
            "motor_off": self.motor_off,
            "speed": self.speed,
            "offset": self.offset,
            "hand_flip": self.hand_flip,
            "block_z": self.block_z,
            "payload": self.payload,
            "second_master": self.second_master,
            "lose_origin": self.lose_origin,
            "input": self.input,
            "arm_locked": self.arm_locked,
            "key_in": self.key_in,
        }

    def alarm(self, code: str = "17.910", at: float | None = None) -> None:
        """An alarm now, or when this fraction of the next motion is done."""
        found = self._machine.dialect.code_of(code)
        if at is None:
            self._machine.trip(found)
        else:
            self._alarm_on_way = found, at

    def mode(self, value: int | str = 1) -> None:
        """A person turns the key or takes the control: 2 automatic, 1 held, 0 manual, -1 restricted, or the name."""
        numbers = {2: Mode.AUTO, 1: Mode.HELD, 0: Mode.MANUAL, -1: Mode.RESTRICTED}
        self._machine.mode = Mode(value) if isinstance(value, str) else numbers[value]
        if self._machine.mode is Mode.HELD:
            self._machine.stop_arm(Code.CONTROL_RIGHT_CHANGED)
        elif self._machine.mode is not Mode.AUTO:
            self._machine.stop_arm(Code.MODE_INPUT_CHANGED)

    def servo_off(self) -> None:
        """A person switches the servos off."""
        self._machine.stop_arm(Code.SERVO_OFF)
        self._machine.power.switch("OFF", None)

    def motor_off(self) -> None:
        """The motor power fails."""
        self._machine.stop_arm(Code.MOTOR_POWER_LOST)
        self._machine.power.cut()

    def speed(self, pct: int = 100, manual: bool = False) -> None:
        """A person changes the speed."""
        self._machine.settings.put("MSPEED" if manual else "ASPEED", pct)

    def offset(self, dx_mm: float = 0.0, dy_mm: float = 0.0, dz_mm: float = 0.0, dr_deg: float = 0.0) -> None:
        """The arm has slipped: the tool is off by so much and the encoders do not know."""
        self._machine.arm.slip = ToolPose(dx_mm, dy_mm, dz_mm, dr_deg)

    def hand_flip(self, on: bool = True) -> None:
        """Positions are reached with the other elbow."""
        self._machine.targets.flip_hands = on

    def block_z(self, at_mm: float | None = None) -> None:
        """Something hard lies at this height; None takes it away."""
        self._blocked_z_mm = at_mm

    def payload(self, kg: float) -> None:
        """What the arm truly carries."""
        self._machine.arm.payload_kg = kg

    def second_master(self, axis: int = 1, mm: float = 5.0) -> None:
        """A person takes the control and moves the tool along x (1), y (2), z (3) or turns it (4)."""
        machine = self._machine
        self.mode(1)
        stands_s = machine.arm.halt()
        target = ToolPose(*changed(machine.arm.commanded_at(stands_s), axis, mm))
        machine.power.switch("ON", None)
        self.later(stands_s - machine.clock.now(), lambda: self._pendant_moves(target))

    def lose_origin(self) -> None:
        """The axes no longer know where they are."""
        self._machine.power.origin = [False] * len(self._machine.power.origin)

    def input(self, port: int, bit: int, on: bool = True, kind: str = "DI") -> None:
        """An unwired input changes."""
        self._machine.ports.set_input(port, bit, on, kind)

    def arm_locked(self, on: bool = True) -> None:
        """The arm lock is set."""
        self._machine.arm_locked = on

    def key_in(self, text: str) -> None:
        """A person answers a program's INPUT at the pendant; raises ValueError when none asks."""
        self._machine.dialogue.answer(text)

    def watch(self, plan: Plan) -> None:
        """A motion begins: what will happen on its way is settled now, so that it is exact in a fast world, too."""
        self._watched = plan
        if self._alarm_on_way is not None:
            code, at = self._alarm_on_way
            self._alarm_on_way = None
            self._ends(plan, plan.halfway_s(at), code, hard=False)
        if self._blocked_z_mm is not None and (at_s := plan.sinks_s(self._blocked_z_mm)) is not None:
            self._ends(plan, at_s, Code.POSITION_DEVIATION, hard=True)

    def _ends(self, plan: Plan, at_s: float, code: Code, *, hard: bool) -> None:
        machine = self._machine
        machine.arm.halt(at_s, hard=hard)

        def trip() -> None:
            if self._watched is plan:
                machine.trip(code)

        self.later(at_s - machine.clock.now(), trip)

    def _pendant_moves(self, target: ToolPose) -> None:
        try:
            self._machine.arm.start(Line(target), PENDANT_PACE)
        except (Unreachable, RuntimeError):
            return
        self._machine.log.add("pendant moves", to=target)
