"""An RCX340 or an RCX240 on the world's arm, with its clients on the network and on a serial line."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Literal

from simulators.robot.clients import Clients
from simulators.robot.codes import Code
from simulators.robot.desk import Desk
from simulators.robot.dialect import Dialect
from simulators.robot.faults import LineFaults
from simulators.robot.framing import ETX, SYN, Negotiation
from simulators.robot.log import Log
from simulators.robot.machine import Machine
from simulators.robot.options import Options
from simulators.robot.ports import Wiring
from simulators.robot.rcx2 import Rcx2
from simulators.robot.rcx3 import Rcx3
from simulators.robot.serial_line import SerialLine
from simulators.robot.session import Session
from simulators.robot.tcp_line import TcpLine
from simulators.robot.world import World

REPLY_S = 0.002
DIALECTS: dict[str, type[Dialect]] = {"rcx3": Rcx3, "rcx2": Rcx2}
DEFAULTS, NO_WIRING = Options(), Wiring()
TELNET_PORT = 23


class RobotController:
    """`port` None = no network; `serial_baud` None = no serial line. Needs a running loop from `start`."""

    def __init__(
        self,
        world: World,
        *,
        dialect: Literal["rcx3", "rcx2"] = "rcx3",
        host: str = "127.0.0.1",
        port: int | None = 0,
        serial_baud: int | None = None,
        serial_link: Path | None = None,
        options: Options = DEFAULTS,
        wiring: Wiring = NO_WIRING,
    ) -> None:
        is_telnet = DIALECTS[dialect].is_network_unit and port == TELNET_PORT
        telnet = is_telnet if options.telnet is None else options.telnet
        options = replace(options, telnet=telnet, echo=telnet if options.echo is None else options.echo)
        self._world, self._clock = world, world.clock
        self._address, self._serial_settings = (host, port), (serial_baud, serial_link)
        self.machine = Machine(world, DIALECTS[dialect](options), wiring)
        self.faults = LineFaults(world.stream("robot line"), world.clock.now, self.machine.dialect.code_of)
        self.desk = Desk(self.machine, self.faults, self._spawn)
        self._clients = Clients(self.machine, self.faults)
        self._server: asyncio.Server | None = None
        self._serial: SerialLine | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._servants: dict[Session, asyncio.Task[None]] = {}
        self._boots_until_s = 0.0
        self.machine.mishaps.later = self.later
        if options.dialogue == "line":
            self.machine.dialogue.tell = self._tell_all
        world.subscribe(self._safety_changed)
        world.register("robot", self.inject)

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

    @property
    def log(self) -> Log:
        """What truly happened."""
        return self.machine.log

    async def start(self) -> None:
        """Power on."""
        (host, port), (baud, link), options = self._address, self._serial_settings, self.machine.dialect.options
        self.machine.start_up(origin=options.origin_at_start)
        if port is not None:
            keep_alive_s = options.keep_alive_s if self.machine.dialect.is_network_unit else 0.0
            self._server = await asyncio.get_running_loop().create_server(
                lambda: TcpLine(self, keep_alive_s=keep_alive_s), host, port
            )
        if baud is not None:
            self._serial = SerialLine(self, self._clock, baud, flow=options.flow == "xonxoff", link=link)
            self._serve(self._serial.session)
        self._safety_changed()

    async def close(self) -> None:
        """Power off."""
        self._world.arm.power(False)
        if self._server is not None:
            self._server.close()
        self._clients.drop()
        if self._server is not None:
            await self._server.wait_closed()
        if self._serial is not None:
            await self._serial.close()
        tasks = [*self._tasks, *self._servants.values()]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)

    # -- clients -----------------------------------------------------------------------------------------

    def joined(self, session: Session) -> bool:
        """A network client."""
        if self._clock.now() < self._boots_until_s or not self._clients.admit(session):
            self.log.add("turned away", client=session.name)
            return False
        self._serve(session)
        return True

    def left(self, session: Session) -> None:
        """The network client is gone; its motion stops, or runs on, as the controller is set."""
        self._clients.leave(session)
        self.desk.forget(session)
        if (servant := self._servants.pop(session, None)) is not None:
            servant.cancel()

    def control(self, session: Session, byte: int) -> None:
        """^C stops the running operation, ^V keeps a jog going."""
        self.log.add("control", client=session.name, byte=byte)
        operation = self.machine.operation
        if operation is None:
            if byte == ETX and self.machine.moving and not self.machine.running():
                self.machine.motions.halt()
        elif operation.session in (session, None):
            if byte == SYN:
                operation.hold()
            elif byte == ETX and operation.moves:
                operation.interrupt(operation.after_stop)

    def negotiated(self, session: Session, told: Negotiation) -> None:
        """The client has said something about telnet."""
        self._clients.negotiated(session, told)

    def _tell_all(self, text: str) -> None:
        """A program prints it, on every line."""
        for session in self._servants:
            self.log.add("said", client=session.name, line=text)
            session.say(text)

    def later(self, for_s: float, do: Callable[[], None]) -> None:
        """Do this after so many world seconds."""
        self._spawn(self._do_later(self._clock.now() + for_s, do))

    def _serve(self, session: Session) -> None:
        task = asyncio.create_task(self._attend(session), name=f"robot serves {session.name}")
        task.add_done_callback(_tell_failure)
        self._servants[session] = task

    async def _attend(self, session: Session) -> None:
        await self._clients.greet(session)
        while True:
            line = await self._clients.next_line(session)
            await self._clock.sleep(max(REPLY_S, self.faults.stalled_s()))
            if self._clock.now() < self._boots_until_s:
                continue
            if line is None or not self._clients.obey(session, line):
                await self.desk.obey(session, line)

    async def _do_later(self, at_s: float, do: Callable[[], None]) -> None:
        await self._clock.sleep_until(at_s)
        do()

    def _spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        task.add_done_callback(_tell_failure)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    # -- safety and faults -------------------------------------------------------------------------------

    def _safety_changed(self) -> None:
        world, machine = self._world, self.machine
        self.log.add("safety", emergency=world.estop_pressed, guard_open=world.guard_open, enable=world.robot_enable)
        if world.estop_pressed:
            machine.trip(Code.EMERGENCY_STOP)
        elif machine.interlocked:
            machine.stop_arm(Code.INTERLOCK)

    def inject(self, fault: str, **params: object) -> None:
        """Make something go wrong; raises ValueError for what there is not or does not fit.

        On the line: see LineFaults, and link_drop(for_s), unplug(for_s), echo(on), padded_codes(on), almrst_ok(on),
        short_position(on). On the robot: see Mishaps, and reboot(for_s, origin, points).
        """
        own: dict[str, Callable[..., None]] = {
            "link_drop": self._link_drop,
            "unplug": self._unplug,
            "reboot": self._reboot,
            "echo": lambda on=True: self._clients.echo(on),
            "padded_codes": lambda on=True: self._set_option(padded_codes=on),
            "almrst_ok": lambda on=True: self._set_option(almrst="ok" if on else "run"),
            "short_position": lambda on=True: self._set_option(position_fields=7 if on else 9),
        }
        verb = own.get(fault) or self.machine.mishaps.verbs().get(fault)
        self.log.add("injected", fault=fault, params=params)
        try:
            if verb is not None:
                verb(**params)
            elif not self.faults.set(fault, **params):  # type: ignore[arg-type]
                raise ValueError(f"the robot has no fault {fault!r}")
        except TypeError as error:
            raise ValueError(f"the robot's fault {fault!r}: {error}") from error

    def _set_option(self, **changed: object) -> None:
        dialect = self.machine.dialect
        dialect.options = replace(dialect.options, **changed)  # type: ignore[arg-type]

    def _link_drop(self, for_s: float = 0.0) -> None:
        self._clients.away_until_s = self._clock.now() + for_s
        self._clients.drop()
        if self._serial is not None:
            self._serial.drop()

    def _unplug(self, for_s: float = 1.0) -> None:
        if self._serial is None:
            raise ValueError("the robot's fault 'unplug' is one of a serial line")
        self._serial.unplug(for_s)

    def _reboot(self, for_s: float = 1.0, origin: bool = True, points: bool = True) -> None:
        machine = self.machine
        machine.trip(Code.CONTROL_POWER_LOST)
        if machine.operation is not None:
            machine.operation.session = None
        self._boots_until_s = self._clock.now() + for_s
        self._link_drop(for_s)
        self.desk.programs.tasks.clear()
        if not points:
            machine.tables.points.clear()
        self.later(for_s, lambda: machine.start_up(origin=origin))


def _tell_failure(task: asyncio.Task[None]) -> None:
    """What no client can have caused is told at once, not when the task is forgotten."""
    if not task.cancelled() and (error := task.exception()) is not None:
        task.get_loop().call_exception_handler({"message": "the simulated robot failed", "exception": error})
