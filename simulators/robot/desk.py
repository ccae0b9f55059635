"""Where a client's line is worked on: what it says, whether it may be done, doing it, and what is said back."""

import asyncio
from collections.abc import Callable, Coroutine

from simulators.robot.codes import Code, Refusal
from simulators.robot.faults import LineFaults, taken
from simulators.robot.files import Files, Upload
from simulators.robot.handlers import JOGS, MOTIONS, POWERS, Handlers
from simulators.robot.language.assignments import Assignment, PortTarget, VariableTarget
from simulators.robot.language.names import FileName, ProgramCommand, network_setting
from simulators.robot.language.nodes import Statement
from simulators.robot.language.statements import statement
from simulators.robot.machine import Machine, MachineScope
from simulators.robot.modes import Mode
from simulators.robot.operation import Ending, Operation, Work, wait_until
from simulators.robot.programs import Programs
from simulators.robot.questions import Questions
from simulators.robot.refusals import Kind
from simulators.robot.session import Session

GAP_S = 0.005  # between two replies that must not come as one: RUN and END
STOP_S = 1.0  # in which programs stop
LOOK_AGAIN_S = 0.002
MODES = {"AUTO": Mode.AUTO, "MANUAL": Mode.MANUAL, "PROGRAM": Mode.PROGRAM, "SYSTEM": Mode.SYSTEM}

Spawn = Callable[[Coroutine[None, None, None]], asyncio.Task[None]]


class Desk:
    """One for all clients: the controller does one operation at a time."""

    def __init__(self, machine: Machine, faults: LineFaults, spawn: Spawn) -> None:
        self.handlers = Handlers(machine)
        self.programs = Programs(machine, self.handlers, spawn)
        self._files = Files(machine, self.programs, self.handlers)
        self._questions = Questions(machine, self.programs)
        self._machine, self._faults, self._spawn = machine, faults, spawn
        self._scope = MachineScope(machine, strict=True)
        self._uploads: dict[Session, Upload] = {}
        self._unsaid: str | None = None

    async def obey(self, session: Session, line: str | None) -> None:
        """Work on one line to the point where the next may come."""
        try:
            await self._obey(session, line)
        except Refusal as refusal:
            self._machine.log.add("refused", client=session.name, code=refusal.code)
            self._say(session, self._machine.dialect.failure(refusal.code))

    def forget(self, session: Session) -> None:
        """The client has gone; a file half way in is lost."""
        self._uploads.pop(session, None)

    async def _obey(self, session: Session, line: str | None) -> None:
        dialect = self._machine.dialect
        if line is None:
            raise Refusal(Code.OVERFLOW)
        if line.strip():
            self._machine.log.add("heard", client=session.name, line=line)
        if session in self._uploads:
            self._take(session, line)
            return
        command = None if self._answers_program(line) else dialect.command(line)
        if command is None:
            return
        if self._faults.refusals:
            raise Refusal(self._faults.refusals.pop(0))
        if dialect.options.when_moving == "refuse" and dialect.keeps_order and self._machine.operation is not None:
            raise Refusal(Code.OPERATING)
        if command.is_question:
            self._answer(session, command.text)
        else:
            await self._do(session, statement(command.text, dialect.words))

    def _answers_program(self, line: str) -> bool:
        """Take a line that no command begins while a program asks for an input, if it may ask on the line."""
        machine, text = self._machine, line.strip()
        if machine.dialect.options.dialogue != "line" or not machine.dialogue.asks or not text or text[0] == "@":
            return False
        machine.dialogue.answer(text)
        return True

    def _answer(self, session: Session, text: str) -> None:
        if session.is_network and self._machine.dialect.is_network_unit and text.startswith("ETHER"):
            network_setting(text.removeprefix("ETHER"))
            self._say(session, str(int(session.echoes)), "OK")
            return
        lines = self._machine.dialect.answer([self._questions.answer(text)])
        unsaid, self._unsaid = self._unsaid, None
        if unsaid is None:
            self._say(session, *lines)
            return
        self._say(session, lines[0])
        self._say(session, unsaid)
        self._say(session, *lines[1:])

    async def _do(self, session: Session, wanted: Statement | Assignment) -> None:
        machine = self._machine
        if isinstance(wanted, Assignment):
            mailbox = isinstance(wanted.target, PortTarget | VariableTarget)
            machine.permit(Kind.OUTPUT if mailbox else Kind.SETTING)
            self.handlers.assign(wanted, self._scope)
            self._say(session, "OK")
        elif wanted.word in MOTIONS:
            after = Code.STOPPED if machine.dialect.options.after_stop == "ng" else None
            await self._run(session, self.handlers.motion(wanted, self._scope, Kind.MOTION), after)
        elif wanted.word in JOGS:
            await self._run(session, self.handlers.jog(wanted), None)
        elif wanted.word in POWERS:
            await self._power(session, wanted)
        elif wanted.word in ("READ", "WRITE"):
            self._file(session, wanted)
        else:
            await self._set(session, wanted)
            self._say(session, "OK")

    async def _set(self, session: Session, wanted: Statement) -> None:
        machine, word, argument = self._machine, wanted.word, wanted.argument
        if (command := self.programs.commands().get(word)) is not None:
            assert isinstance(argument, ProgramCommand)
            command(argument)
            if word == "STOP":
                await self._until(lambda: not machine.running(), STOP_S)
        elif word in MODES:
            machine.permit(Kind.MODE)
            machine.mode = MODES[word]
        elif word in ("TEACH", "TCHXY"):
            self._teach(wanted)
        elif word == "WAIT":
            await self._until(lambda: not machine.arm.moving_at(machine.clock.now()))
        elif word == "ETHER":
            self._echo(session, argument)
        else:
            machine.permit(Kind.OUTPUT if word in ("SET", "RESET OUTPUT") else Kind.SETTING)
            if not self.handlers.set(wanted, self._scope):
                raise Refusal(Code.NO_SUCH_COMMAND)

    def _teach(self, wanted: Statement) -> None:
        machine = self._machine
        machine.permit(Kind.SETTING)
        assert isinstance(wanted.argument, int)
        number = machine.tables.point_number(wanted.argument)
        in_mm = wanted.word == "TCHXY" or machine.settings.number("UNIT") == 1
        machine.tables.points[number] = machine.targets.here() if in_mm else machine.targets.here_in_pulses()

    def _echo(self, session: Session, argument: object) -> None:
        if not session.is_network or not isinstance(argument, tuple):
            raise Refusal(Code.NO_SUCH_COMMAND)
        session.echoes = argument[1] == "1"

    def _file(self, session: Session, wanted: Statement) -> None:
        dialect, name = self._machine.dialect, wanted.argument
        assert isinstance(name, FileName)
        if wanted.word == "READ":
            begin = [dialect.begins_data] if dialect.begins_data else []
            self._say(session, *begin, *self._files.read(name), "END")
        else:
            self._uploads[session] = self._files.write(name)
            self._say(session, "READY")

    def _take(self, session: Session, line: str) -> None:
        upload = self._uploads[session]
        try:
            if upload.take(line):
                del self._uploads[session]
                upload.end()
                self._say(session, "OK")
        except Refusal:
            self._uploads.pop(session, None)
            raise

    # -- operations --------------------------------------------------------------------------------------

    async def _power(self, session: Session, wanted: Statement) -> None:
        options = self._machine.dialect.options
        reply = {"ALMRST": options.almrst, "SERVO": options.servo_reply}.get(wanted.word, "run")
        work = self.handlers.power(wanted, self._scope)
        await self._run(session, work, None, moves=False, brief=reply == "ok")

    async def _run(
        self, session: Session, work: Work, after_stop: Ending, *, moves: bool = True, brief: bool = False
    ) -> None:
        machine = self._machine
        operation = Operation(machine.clock, session, moves=moves, after_stop=after_stop)
        machine.operation = operation
        run_s = machine.clock.now() + taken(self._faults.late_run_s)
        accepted = None if brief else machine.dialect.accepted
        if accepted is not None and run_s > machine.clock.now():
            self._spawn(self._accept_late(operation, accepted, run_s))
        elif accepted is not None:
            self._say(session, accepted)
        running = self._spawn(self._run_to_end(operation, work, run_s, brief=brief))
        if machine.dialect.keeps_order and machine.dialect.options.when_moving == "wait":
            await asyncio.wait((running,))

    async def _accept_late(self, operation: Operation, accepted: str, run_s: float) -> None:
        await wait_until(self._machine.clock, run_s)
        if self._machine.operation is operation:
            self._say(operation.session, accepted)

    async def _run_to_end(self, operation: Operation, work: Work, run_s: float, *, brief: bool) -> None:
        clock = self._machine.clock
        try:
            ending = await work(operation)
            if not operation.interrupted:
                await wait_until(clock, run_s + GAP_S)
        except Refusal as refusal:  # of a later target of several
            ending = refusal.code
        finally:
            if self._machine.operation is operation:
                self._machine.operation = None
        if late_s := taken(self._faults.late_end_s):
            await clock.sleep(late_s)
        if ending is None and self._faults.failures:
            ending = self._faults.failures.pop(0)
        self._end(operation, ending, brief=brief)

    def _end(self, operation: Operation, ending: Ending, *, brief: bool) -> None:
        dialect = self._machine.dialect
        said = dialect.failure(ending) if ending is not None else "OK" if brief else dialect.finished
        if ending is None and self._faults.lost_end:
            self._faults.lost_end -= 1
        elif self._faults.interleave:
            self._unsaid = said
        else:
            self._say(operation.session, said)

    async def _until(self, so: Callable[[], bool], within_s: float = 60.0) -> None:
        deadline_s = self._machine.clock.now() + within_s
        while not so() and self._machine.clock.now() < deadline_s:
            await self._machine.clock.sleep(LOOK_AGAIN_S)

    def _say(self, session: Session | None, *lines: str) -> None:
        if session is None:
            return
        for line in lines:
            self._machine.log.add("said", client=session.name, line=line)
        session.say(*lines)
