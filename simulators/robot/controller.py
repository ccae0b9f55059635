"""The controller model: who talks, what is refused, what runs, and what the safety inputs do to it."""

import asyncio
from collections.abc import Coroutine
from typing import Literal

from simulators.robot import text
from simulators.robot.faults import LineFaults
from simulators.robot.line import ETX, SYN, SerialFront, Session, TcpFront
from simulators.robot.motions import Motions, position, pulses
from simulators.robot.operation import Operation, Work, wait_until
from simulators.robot.power import EMERGENCY, INTERLOCK, NO_ALARM, Power
from simulators.robot.registers import AUTO_HELD, Registers
from simulators.robot.text import Command, Refusal
from simulators.robot.world import World

REPLY_S = 0.002
GAP_S = 0.005  # between two replies that must not come as one: greeting and blank line, RUN and END
HELD_BACK_S = 0.05
MOTOR_S, SERVO_S, ORIGIN_S, RESET_S = 0.2, 0.1, 0.1, 0.03
WHILE_BUSY = ("STOP", "DO", "MO", "SO")


class RobotController:
    """An RCX340. `port` None = no network; `serial_baud` None = no serial line. Needs a running loop from `start`."""

    def __init__(
        self,
        world: World,
        *,
        host: str = "127.0.0.1",
        port: int | None = 0,
        serial_baud: int | None = None,
        on_disconnect: Literal["stop", "continue"] = "stop",
    ) -> None:
        self._world = world
        self._clock, self._arm = world.clock, world.arm
        self._address = (host, port)
        self._serial_baud = serial_baud
        self._on_disconnect = on_disconnect
        self._faults = LineFaults(world.stream("robot line"))
        self._registers = Registers()
        self._motions = Motions(self._clock, self._arm, self._registers, self._permit_motion)
        self._settings = self._registers.settings()
        self._power = Power(world, self._registers)
        self._queries = self._registers.queries() | self._power.queries()
        self._operations = self._motions.commands()
        self._operation: Operation | None = None
        self._unsaid_ending: str | None = None
        self._held_back: list[bytes] = []
        self._client: Session | None = None
        self._away_until_s = 0.0
        self._server: asyncio.Server | None = None
        self._serial: SerialFront | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._servants: dict[Session, asyncio.Task[None]] = {}
        world.subscribe(self._safety_changed)
        world.register("robot", self._inject)

    @property
    def port(self) -> int:
        """The TCP port that is listened on."""
        assert self._server is not None, "start() the controller first"
        return int(self._server.sockets[0].getsockname()[1])

    @property
    def tty(self) -> str:
        """The path of the serial line's terminal."""
        assert self._serial is not None, "start() the controller with serial_baud first"
        return self._serial.tty

    async def start(self) -> None:
        """Power on: motor off, origin complete, automatic mode with the control released."""
        host, port = self._address
        if port is not None:
            self._server = await asyncio.get_running_loop().create_server(lambda: TcpFront(self), host, port)
        if self._serial_baud is not None:
            self._serial = SerialFront(self, self._clock, self._serial_baud)
            self._servants[self._serial.session] = asyncio.create_task(self._serve(self._serial.session))
        self._safety_changed()

    async def close(self) -> None:
        """Power off."""
        self._arm.power(False)
        if self._server is not None:
            self._server.close()
        if self._client is not None:
            self._client.carrier.drop()
        if self._server is not None:
            await self._server.wait_closed()
        if self._serial is not None:
            await self._serial.close()
        tasks = [*self._tasks, *self._servants.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    # -- clients -----------------------------------------------------------------------------------------

    def joined(self, session: Session) -> bool:
        """One network client at a time."""
        if self._client is not None or self._clock.now() < self._away_until_s:
            return False
        self._client = session
        self._servants[session] = asyncio.create_task(self._serve(session))
        return True

    def left(self, session: Session) -> None:
        """The network client is gone; its motion stops, or runs on, as the controller is set."""
        self._client = None
        self._servants.pop(session).cancel()
        operation = self._operation
        if operation is not None and operation.session is session:
            operation.session = None
            if self._on_disconnect == "stop" and operation.is_motion:
                operation.interrupt("NG=14.400")

    def control(self, session: Session, byte: int) -> None:
        """^C stops the running operation, ^V keeps a jog going."""
        operation = self._operation
        if operation is None or operation.session not in (session, None):
            return
        if byte == SYN:
            operation.hold()
        elif byte == ETX and operation.stopped_by_client is not None:
            operation.interrupt(operation.stopped_by_client)

    async def _serve(self, session: Session) -> None:
        if session.greets:
            self._reply(session, "Welcome to RCX340")
            await self._pause(GAP_S)
            self._reply(session, "")
        while True:
            line = await session.lines.get()
            await self._pause(REPLY_S)
            try:
                self._obey(session, line)
            except Refusal as refusal:
                self._reply(session, f"NG={refusal.code}")

    def _reply(self, session: Session | None, line: str) -> None:
        if session is None:
            return
        for piece in self._faults.spoilt(line):
            if self._faults.coalesce:
                self._hold_back(session, piece)
            else:
                session.carrier.write(piece)

    def _hold_back(self, session: Session, piece: bytes) -> None:
        self._held_back.append(piece)
        if len(self._held_back) == 1:
            self._spawn(self._let_go(session))

    async def _let_go(self, session: Session) -> None:
        await self._pause(HELD_BACK_S)
        pieces, self._held_back = self._held_back, []
        session.carrier.write(b"".join(pieces))

    async def _pause(self, for_s: float) -> None:
        await wait_until(self._clock, self._clock.now() + for_s)

    def _spawn(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # -- commands ----------------------------------------------------------------------------------------

    def _obey(self, session: Session, line: str | None) -> None:
        if line is None:
            raise Refusal("14.211")
        command = text.parse_command(line)
        if command is None:
            return
        if command.is_query:
            self._answer(session, command)
        elif command.word in self._operations:
            prepare, stopped = self._operations[command.word]
            self._run(session, prepare(command.rest), stopped)
        elif command.word in ("MOTOR", "SERVO", "ORIGIN", "ORGRTN", "ALMRST"):
            self._power_command(session, command)
        else:
            self._set(command)
            self._reply(session, "OK")

    def _answer(self, session: Session, command: Command) -> None:
        answer = self._queries.get(command.word)
        if answer is None:
            raise Refusal("5.252")
        self._reply(session, answer(command.rest))
        if self._unsaid_ending is not None:
            ending, self._unsaid_ending = self._unsaid_ending, None
            self._reply(session, ending)
        self._reply(session, "OK")

    def _set(self, command: Command) -> None:
        if command.word in ("STOP", "RESET"):
            self._not_busy(command.word)
        elif command.word in ("RUN", "LOAD"):
            raise Refusal("3.208" if command.word == "RUN" else "3.203")  # there are no programs
        elif command.word in ("TCHXY", "TEACH"):
            self._not_busy(command.word)
            self._teach(command)
        elif setting := self._settings.get(command.word):
            self._not_busy(command.word)
            setting(command.rest)
        else:
            raise Refusal("5.252")

    def _teach(self, command: Command) -> None:
        number = text.point_number(f"P{command.rest.strip().removeprefix('P')}")
        joints = self._arm.joints_at(self._clock.now())
        line = position(joints) if command.word == "TCHXY" else f"{pulses(joints)} {int(joints.hand)}"
        self._registers.points[number] = text.point_data(line)

    def _power_command(self, session: Session, command: Command) -> None:
        if command.word == "ALMRST":
            self._reset_alarm(session)
            return
        power = self._power
        on, axes = power.wish(command)
        if on:
            power.permit_power()
        self._not_busy(command.word)
        switches_power = command.word == "MOTOR" or (on and not power.motor)

        async def work(operation: Operation) -> str:
            ending = await operation.until(self._clock.now() + (MOTOR_S if switches_power else SERVO_S))
            if ending is None and command.word in ("MOTOR", "SERVO"):
                power.switch(on, axes, motor=on or (power.motor and command.word == "SERVO"))
            return ending or "END"

        self._run(session, work, None)

    def _reset_alarm(self, session: Session) -> None:
        if self._world.estop_pressed:
            raise Refusal(EMERGENCY)
        self._not_busy("ALMRST")
        if self._faults.almrst_ok:
            self._power.alarm = NO_ALARM
            self._reply(session, "OK")
            return

        async def work(operation: Operation) -> str:
            ending = await operation.until(self._clock.now() + RESET_S)
            if ending is None:
                self._power.alarm = NO_ALARM
            return ending or "END"

        self._run(session, work, None)

    # -- operations --------------------------------------------------------------------------------------

    def _run(self, session: Session, work: Work, stopped_by_client: str | None) -> None:
        operation = self._operation = Operation(self._clock, session, stopped_by_client)
        run_s = self._clock.now()
        if self._faults.late_run_s:
            run_s += self._faults.late_run_s.pop(0)
            self._spawn(self._say_run_late(operation, run_s))
        else:
            self._reply(session, "RUN")
        self._spawn(self._run_to_end(operation, work, run_s))

    async def _say_run_late(self, operation: Operation, run_s: float) -> None:
        await wait_until(self._clock, run_s)
        if self._operation is operation:
            self._reply(operation.session, "RUN")

    async def _run_to_end(self, operation: Operation, work: Work, run_s: float) -> None:
        try:
            ending = await work(operation)
        except Refusal as refusal:  # of a later target of several
            ending = f"NG={refusal.code}"
        if ending == "END":
            await wait_until(self._clock, run_s + GAP_S)
        self._operation = None
        said = self._faults.ending(ending)
        if said is not None and self._faults.interleave:
            self._unsaid_ending = said
        elif said is not None:
            self._reply(operation.session, said)

    def _permit_motion(self, axes: tuple[int, ...], only_automatic: bool) -> None:
        """The order of refusals: emergency stop, alarm, interlock, mode, busy, motor, servo."""
        self._power.permit_motion(only_automatic=only_automatic)
        self._not_busy("MOVE")
        self._power.permit_axes(axes)

    def _not_busy(self, word: str) -> None:
        if self._operation is not None and word not in WHILE_BUSY:
            raise Refusal("6.282" if self._operation.is_motion else "6.280")

    # -- safety and faults -------------------------------------------------------------------------------

    def _safety_changed(self) -> None:
        if self._world.estop_pressed:
            self._trip(EMERGENCY)
        elif self._operation is not None and self._operation.is_motion and self._power.interlocked:
            self._operation.interrupt(f"NG={INTERLOCK}")

    def _trip(self, alarm: str) -> None:
        """Power off, and what runs fails."""
        self._power.trip(alarm)
        if self._operation is not None:
            self._operation.interrupt(f"NG={alarm}")

    def _inject(self, fault: str, **params: object) -> None:
        """Faults: alarm(code), mode(value), link_drop(for_s), and those of the line (see LineFaults)."""
        if fault == "alarm":
            self._trip(str(params.pop("code", "17.910")))
        elif fault == "mode":
            self._registers.mode = int(str(params.pop("value", AUTO_HELD)))
        elif fault == "link_drop":
            self._away_until_s = self._clock.now() + float(str(params.pop("for_s", 0.0)))
            for carrier in (self._client and self._client.carrier, self._serial):
                if carrier:
                    carrier.drop()
        else:
            self._faults.set(fault, **params)  # type: ignore[arg-type]
            return
        if params:
            raise ValueError(f"the robot's fault {fault!r} does not know {', '.join(params)}")
