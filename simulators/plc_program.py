"""The program in the simulated PLC, in scan style: read sensors, logic, drive actuators.

It knows the register map as numbers of its own, shares none with the driver, and touches the outside only through the
world's sensors and actuators and the memory words 0..15 and 100..131. Process timers run in world seconds; what watches
the client (heartbeat, session) runs in wall seconds, because the client is not accelerated.
"""

from collections.abc import Callable, MutableMapping
from enum import Enum, auto
from typing import Protocol

OK, WRONG_STATE, UNKNOWN, TIMED_OUT, FAULT, NOT_YOUR_SESSION = range(6)
STARTING, READY, RUNNING, CLIENT_SILENT, STATE_FAULT, EMERGENCY_STOP = range(6)
BRING, RELEASE_GOOD, RELEASE_REJECT, STOP_CONVEYOR, RESET_LATCHES = range(1, 6)

MAP_VERSION = 0x0100
START_WALL_S = 0.02
HEARTBEAT_WALL_S = 0.5
SESSION_WALL_S = 1.0
DEBOUNCE_S = 0.02
BRING_S = 8.0
CLAMP_S = 1.0
LEAVE_S = 4.0
REACHED_KPA, LOST_KPA = -40.0, -35.0

NO_FAULT, FAULT_JAMMED, FAULT_CLAMP = range(3)  # register 114


class PlcWorld(Protocol):
    """What the PLC is wired to."""

    estop_pressed: bool
    guard_open: bool
    air_ok: bool
    robot_enable: bool

    def photo_switch(self) -> bool:
        """A carrier is in the light beam at the station."""

    def carrier_clamped(self) -> bool:
        """The clamp holds a carrier."""

    def battery_on_table(self) -> bool:
        """Presence sensor of the table."""

    def conveyor_moving(self) -> bool:
        """The belt turns."""

    def vacuum_kpa(self) -> float:
        """At the cup, negative when sucking."""

    def carrier_id(self) -> int:
        """Of the carrier at the station, 0 = none."""

    def drive_conveyor(self, on: bool) -> None:
        """Belt motor."""

    def clamp(self, on: bool) -> None:
        """Carrier clamp."""

    def release_carrier(self, good: bool) -> None:
        """Lower the stop pin; the diverter sends the carrier to good or reject."""

    def valve(self, on: bool) -> None:
        """Vacuum valve."""

    def blow(self, on: bool) -> None:
        """Blow-off valve."""

    def light(self, camera: int, on: bool) -> None:
        """Light of camera 1 or 2."""

    def lamps(self, red: bool, amber: bool, green: bool, buzzer: bool) -> None:
        """Signal tower."""


class Program(Protocol):
    """What a PLC executes; another program for the same register map may take its place."""

    def scan(self, now_world_s: float, now_wall_s: float) -> None:
        """One PLC cycle."""

    def halt(self) -> None:
        """The PLC goes to STOP: outputs that can move something drop."""


class Debounce:
    """A switch that counts as changed when two scans in a row, and all for `for_s`, saw it so."""

    def __init__(self, for_s: float) -> None:
        self._for_s = for_s
        self._changed_s: float | None = None
        self.on = False

    def step(self, raw: bool, now_s: float) -> None:
        """One scan."""
        if raw == self.on:
            self._changed_s = None
        elif self._changed_s is None:
            self._changed_s = now_s
        elif now_s - self._changed_s >= self._for_s:
            self.on = raw
            self._changed_s = None


class Client:
    """Which cellctl is served, whether it lives, and the last words of the one that is served."""

    def __init__(self, words: list[int], now_wall_s: float) -> None:
        self.served = 0
        self.alive = False
        self.words = [0] * 16
        self.known = False  # somebody was served since the PLC started
        self.foreign = 0  # session of a refused client whose words stand in the memory now
        self._last = (words[1], words[0])
        self._beat_wall_s = now_wall_s

    def step(self, words: list[int], now_wall_s: float) -> bool:
        """One scan; True when a session begins to be served."""
        heartbeat, session = words[0], words[1]
        beats = (session, heartbeat) != self._last
        self._last = (session, heartbeat)
        if self.served and now_wall_s - self._beat_wall_s > SESSION_WALL_S:
            self.served = 0
        begins = self.served == 0 and session != 0 and beats
        if begins:
            self.served = session
            self.known = True
        self.foreign = session if session != self.served else 0
        if session == self.served != 0:
            if begins or heartbeat != self.words[0]:
                self._beat_wall_s = now_wall_s
            self.words = list(words)
        self.alive = self.served != 0 and now_wall_s - self._beat_wall_s <= HEARTBEAT_WALL_S
        return begins


class Step(Enum):
    """Where the conveyor's sequence stands."""

    IDLE = auto()
    BRINGING = auto()
    CLAMPING = auto()
    LEAVING = auto()


class PlcProgram:
    """The contract of the register map, executed."""

    def __init__(
        self,
        world: PlcWorld,
        memory: MutableMapping[int, int],
        *,
        boot: int,
        now_wall_s: float,
        photo_switch: Callable[[], bool],
        buttons: Callable[[], int],  # bits start, stop, reset
    ) -> None:
        self._world = world
        self._memory = memory
        self._boot = boot
        self._photo_switch = photo_switch
        self._buttons = buttons
        self._started_wall_s = now_wall_s
        self._client = Client(self._orders(), now_wall_s)
        self._photo = Debounce(DEBOUNCE_S)
        self._pressed = 0
        self._presses = [0, 0]
        self._safety = 0
        self._lost = 0
        self._step = Step.IDLE
        self._step_since_s = 0.0
        self._accepted = self._finished = self._result = 0
        self._fault = 0
        self._arrivals = 0
        self._arrived_s: float | None = None
        self._vacuum = False
        self._cycles = 0
        self._scanned_wall_s = now_wall_s

    def scan(self, now_world_s: float, now_wall_s: float) -> None:
        """One PLC cycle."""
        words = self._orders()
        if self._client.step(words, now_wall_s) and words[3] != self._accepted:
            # What a client wrote before it was served is refused, not executed later.
            self._accepted = self._finished = words[3]
            self._result = NOT_YOUR_SESSION
        self._read_inputs(now_world_s)
        self._watch_safety()
        if now_wall_s - self._started_wall_s >= START_WALL_S:
            self._take_command(now_world_s)
            self._run_conveyor(now_world_s)
        self._drive()
        self._publish(words, now_world_s, now_wall_s)

    def halt(self) -> None:
        """The PLC goes to STOP: enable and conveyor drop, the vacuum valve is bistable and stays."""
        self._world.robot_enable = False
        self._world.drive_conveyor(False)
        self._world.blow(False)

    def _orders(self) -> list[int]:
        return [self._memory[at] for at in range(16)]

    def _read_inputs(self, now_world_s: float) -> None:
        self._photo.step(self._photo_switch(), now_world_s)
        limit_kpa = LOST_KPA if self._vacuum else REACHED_KPA
        self._vacuum = self._world.vacuum_kpa() < limit_kpa
        before, self._pressed = self._pressed, self._buttons()
        new = self._pressed & ~before
        self._presses = [(count + (new >> at & 1)) & 0xFF for at, count in enumerate(self._presses)]

    def _watch_safety(self) -> None:
        world = self._world
        estop_healthy, guard_closed = not world.estop_pressed, not world.guard_open
        enable = estop_healthy and guard_closed and self._client.alive
        now = estop_healthy | guard_closed << 1 | world.air_ok << 2 | enable << 3
        self._lost |= self._safety & ~now
        self._safety = now
        if self._step is not Step.IDLE and not enable:
            self._finish(FAULT)

    def _take_command(self, now_world_s: float) -> None:
        words = self._client.words
        number, command, argument = words[3:6]
        waits = self._step is not Step.IDLE and command != STOP_CONVEYOR
        if not self._client.alive or number == self._accepted or waits:
            return
        self._step = Step.IDLE
        self._accepted = number
        if command == BRING:
            self._begin_bring(now_world_s)
        elif command in (RELEASE_GOOD, RELEASE_REJECT):
            self._begin_release(argument, command == RELEASE_GOOD, now_world_s)
        elif command == RESET_LATCHES:
            self._lost = self._fault = 0
            self._finish(OK)
        else:
            self._finish(OK if command == STOP_CONVEYOR else UNKNOWN)

    def _begin_bring(self, now_s: float) -> None:
        if self._world.carrier_clamped() or not self._may_move():
            self._finish(WRONG_STATE)
        else:
            self._world.clamp(False)
            self._go(Step.BRINGING, now_s)

    def _begin_release(self, carrier_id: int, good: bool, now_s: float) -> None:
        here = self._world.carrier_id()
        if here == 0 or here != carrier_id or not self._world.carrier_clamped() or not self._may_move():
            self._finish(WRONG_STATE)
        else:
            self._world.clamp(False)
            self._world.release_carrier(good)
            self._go(Step.LEAVING, now_s)

    def _may_move(self) -> bool:
        return bool(self._safety & 8) and self._fault == NO_FAULT

    def _run_conveyor(self, now_s: float) -> None:
        took_s = now_s - self._step_since_s
        if self._step is Step.BRINGING and self._photo.on:
            self._world.drive_conveyor(False)
            self._world.clamp(True)
            self._go(Step.CLAMPING, now_s)
        elif self._step is Step.BRINGING and took_s > BRING_S:
            self._finish(TIMED_OUT)  # no carrier came: the line is empty, the PLC is well
        elif self._step is Step.CLAMPING and self._world.carrier_clamped():
            self._arrivals = (self._arrivals + 1) & 0xFFFF
            self._arrived_s = now_s
            self._finish(OK)
        elif self._step is Step.CLAMPING and took_s > CLAMP_S:
            self._fault = FAULT_CLAMP
            self._finish(TIMED_OUT)
        elif self._step is Step.LEAVING and not self._photo.on:
            self._finish(OK)
        elif self._step is Step.LEAVING and took_s > LEAVE_S:
            self._fault = FAULT_JAMMED
            self._finish(TIMED_OUT)

    def _go(self, step: Step, now_s: float) -> None:
        self._step, self._step_since_s = step, now_s

    def _finish(self, result: int) -> None:
        self._step = Step.IDLE
        self._finished, self._result = self._accepted, result

    def _drive(self) -> None:
        world, outputs = self._world, self._client.words[6]
        world.robot_enable = bool(self._safety & 8)
        world.drive_conveyor(self._step in (Step.BRINGING, Step.LEAVING))
        if self._client.known:  # bistable: a part must not fall when the PLC starts or the client is silent
            world.valve(bool(outputs & 1))
        world.blow(bool(outputs & 2) and self._client.alive)
        world.light(1, bool(outputs & 4))
        world.light(2, bool(outputs & 8))
        world.lamps(bool(outputs & 16), bool(outputs & 32), bool(outputs & 64), bool(outputs & 128))

    def _state(self, now_wall_s: float) -> int:
        """The first of these that holds."""
        if now_wall_s - self._started_wall_s < START_WALL_S:
            return STARTING
        if not self._safety & 1:
            return EMERGENCY_STOP
        if self._fault != NO_FAULT:
            return STATE_FAULT
        if not self._client.alive:
            return CLIENT_SILENT
        return READY if self._step is Step.IDLE else RUNNING

    def _publish(self, words: list[int], now_world_s: float, now_wall_s: float) -> None:
        self._cycles = (self._cycles + 1) & 0xFFFF
        refused = self._client.foreign != 0 and words[3] != self._accepted
        handshake = (
            (words[3], words[3], NOT_YOUR_SESSION) if refused else (self._accepted, self._finished, self._result)
        )
        age_s = 0.0 if self._arrived_s is None else now_world_s - self._arrived_s
        age_ms = min(round(age_s * 1000), 0xFFFFFFFF)
        cycle = min(round((now_wall_s - self._scanned_wall_s) * 10_000), 0xFFFF)
        self._scanned_wall_s = now_wall_s
        picture = (
            self._cycles,
            MAP_VERSION,
            self._client.served,
            self._state(now_wall_s),
            self._safety,
            self._inputs(),
            self._lost,
            *handshake,
            self._arrivals,
            age_ms >> 16,
            age_ms & 0xFFFF,
            self._world.carrier_id() & 0xFFFF,
            self._fault,
            round(self._world.vacuum_kpa() * 10) & 0xFFFF,
            cycle,
            self._boot & 0xFFFF,
            self._presses[0] | self._presses[1] << 8,
        )
        self._memory.update(zip(range(100, 100 + len(picture)), picture, strict=True))

    def _inputs(self) -> int:
        world = self._world
        return (
            self._photo.on
            | self._vacuum << 1
            | world.carrier_clamped() << 2
            | world.battery_on_table() << 3
            | world.conveyor_moving() << 4
            | self._pressed << 5
        )
