"""Who is connected over the network: one at a time, greeted, and, on the older board, echoed and timed out."""

import asyncio

from simulators.robot.codes import Code
from simulators.robot.faults import LineFaults, taken
from simulators.robot.framing import DO, DONT, IAC, WILL, WONT, Negotiation
from simulators.robot.machine import Machine
from simulators.robot.session import Session

GREETING_GAP_S = 0.005  # the greeting and its blank line must not come as one
ECHO, SUPPRESS_GO_AHEAD = 1, 3
OFFERED = (ECHO, SUPPRESS_GO_AHEAD)
BOARD_VERSION = "Version_1.01"
GOOD_BYES = ("LOGOUT", "BYE")


class Clients:
    """The network side of the controller; the serial line has one client for ever."""

    def __init__(self, machine: Machine, faults: LineFaults) -> None:
        self.away_until_s = 0.0
        self._machine, self._faults = machine, faults
        self._here: list[Session] = []
        self._agreed: dict[Session, set[tuple[int, int]]] = {}

    def admit(self, session: Session) -> bool:
        """Whether a client may come in."""
        several = self._machine.dialect.options.second_client == "serve"
        if (self._here and not several) or self._machine.clock.now() < self.away_until_s:
            return False
        self._here.append(session)
        self._agreed[session] = set()
        session.echoes = bool(self._machine.dialect.options.echo)
        self._machine.log.add("joined", client=session.name)
        return True

    def leave(self, session: Session) -> None:
        """It has gone. Without a good-bye the older board stops the robot; the newer one as it is set."""
        machine = self._machine
        self._here.remove(session)
        del self._agreed[session]
        machine.log.add("left", client=session.name, logged_out=session.logged_out)
        operation = machine.operation
        if operation is not None and operation.session is session:
            operation.session = None
        if session.logged_out:
            return
        if machine.dialect.is_network_unit:
            machine.report(Code.COMMUNICATION)
            machine.stop_arm(Code.COMMUNICATION)
        elif machine.dialect.options.on_disconnect == "stop" and operation is not None and operation.moves:
            machine.stop_arm(Code.DISCONNECTED)
        if machine.dialect.options.lost_link_refusal:
            self._faults.refusals.insert(0, Code.DISCONNECTED)

    def drop(self) -> None:
        """The network breaks."""
        for session in list(self._here):
            session.carrier.drop()

    async def greet(self, session: Session) -> None:
        """The first words to a network client."""
        if not session.is_network:
            return
        machine, options = self._machine, self._machine.dialect.options
        if options.telnet:
            session.tell(bytes(byte for option in OFFERED for byte in (IAC, WILL, option)))
        greeting = options.greeting or machine.dialect.greeting
        if greeting is None:
            return
        await machine.clock.sleep(taken(self._faults.late_greeting_s))
        session.say(greeting)
        await machine.clock.sleep(GREETING_GAP_S)
        session.say("")

    async def next_line(self, session: Session) -> str | None:
        """The next line; the older board hangs up on a client that is silent for too long."""
        silence_s = self._machine.dialect.options.silence_min * 60 / self._machine.clock.speed
        is_timed = session.is_network and self._machine.dialect.is_network_unit and silence_s > 0
        try:
            async with asyncio.timeout(silence_s if is_timed else None):
                return await session.next_line()
        except TimeoutError:
            session.carrier.hang_up()
            return await session.next_line()  # there is none: the client's leaving ends this

    def obey(self, session: Session, line: str) -> bool:
        """The board's own commands, which need no @; False when it is none of them."""
        if not (session.is_network and self._machine.dialect.is_network_unit):
            return False
        word = line.strip().upper()
        if word in GOOD_BYES:
            session.logged_out = True
            session.carrier.hang_up()
        elif word == "VER":
            session.say(BOARD_VERSION)
        else:
            return False
        return True

    def echo(self, on: bool) -> None:
        """Send every client its own characters back, or not."""
        for session in self._here:
            session.echoes = on

    def negotiated(self, session: Session, told: Negotiation) -> None:
        """Agree to echoing and to no go-ahead, refuse all else, and answer nothing twice."""
        if not self._machine.dialect.options.telnet or told in self._agreed.get(session, ()):
            return
        self._agreed[session].add(told)
        if told.option == ECHO and told.verb in (DO, DONT):
            session.echoes = told.verb == DO
        elif told.verb == DO and told.option not in OFFERED:
            session.tell(bytes((IAC, WONT, told.option)))
        elif told.verb == WILL:
            session.tell(bytes((IAC, DONT, told.option)))
