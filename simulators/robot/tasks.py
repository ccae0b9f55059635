"""A program that runs: statement by statement, in world time, until it ends, is stopped, or goes wrong."""

import asyncio
from collections.abc import Callable

from simulators.moves import Go
from simulators.robot.codes import Code, Refusal
from simulators.robot.flow import Flow
from simulators.robot.handlers import MOTIONS, POWERS, Handlers
from simulators.robot.language.assignments import Assignment, told
from simulators.robot.language.commands import pieces
from simulators.robot.language.nodes import Block, Call, Choice, Input, Jump, Line, Statement, Wait
from simulators.robot.language.program import Program
from simulators.robot.language.values import integer
from simulators.robot.machine import Machine
from simulators.robot.motions import Given
from simulators.robot.operation import Operation, Work
from simulators.robot.refusals import Kind
from simulators.robot.task_scope import TaskScope
from simulators.scara import Joints

STATEMENT_S = 0.0005
LOOK_AGAIN_S = 0.002
LONGEST_WAIT_MS = 3_600_000
RELATIVE = ("MOVEI", "DRIVEI")
OTHERS = ("HOLD", "HOLDALL", "HALTALL", "EXIT TASK")  # what concerns this task from outside, or others
RUNS, STOPS = "R", "S"


class Task:
    """One of the controller's tasks with its program. `asks` takes what concerns other tasks."""

    def __init__(
        self,
        number: int,
        program: Program,
        machine: Machine,
        handlers: Handlers,
        asks: Callable[["Task", Statement | Block], None],
    ) -> None:
        self.number, self.program = number, program
        self.state = STOPS
        self.priority = 32
        self._machine, self._handlers, self._asks = machine, handlers, asks
        self._scope = TaskScope(machine)
        self._flow = Flow(program, self._scope)
        self._stopped_by: Code | None = None
        self._resumes_at: Joints | None = None
        self._operation: Operation | None = None

    @property
    def line_number(self) -> int:
        """The line where it is, from 1; 0 when it has been reset."""
        return self._flow.line_number

    @property
    def at_start(self) -> bool:
        """Whether it has been reset."""
        return self._flow.at == 0 and self.state == STOPS

    def reset(self) -> None:
        """To its first statement."""
        self._flow.reset()
        self._resumes_at = None

    def begin(self) -> None:
        """It runs from now on; whoever calls this starts `run`."""
        self._to_state(RUNS)
        self._stopped_by = None

    def stop(self, code: Code) -> None:
        """It stops where it is; it may begin again from there."""
        self._stopped_by = self._stopped_by or code
        if self._operation is not None:
            self._operation.interrupt(code)

    async def run(self) -> None:
        """Until it ends, is stopped, or goes wrong."""
        try:
            while self._stopped_by is None and (line := self._flow.line) is not None:
                await asyncio.sleep(0)
                await self._machine.clock.sleep(STATEMENT_S)
                await self._step_or_trap(line)
            self._end()
        except Refusal as refusal:
            self._machine.report(refusal.code, self._flow.line_number or 1)
        finally:
            self._to_state(STOPS)

    # -- statement by statement --------------------------------------------------------------------------

    async def _step_or_trap(self, line: Line) -> None:
        try:
            await self._step(line)
        except Refusal as refusal:
            if not self._flow.trapped(refusal):
                raise

    async def _step(self, line: Line) -> None:
        if self._stopped_by is not None:
            return
        next_at = await self._execute(line)
        if next_at is not None:
            self._flow.at = next_at
        elif self._stopped_by is None:
            self._flow.at += 1

    async def _execute(self, line: Line) -> int | None:
        """Do it; returns the index of the next statement when it is not the one behind."""
        if isinstance(line, Assignment):
            self._handlers.assign(line, self._scope)
        elif isinstance(line, Statement):
            await self._command(line)
        elif isinstance(line, Jump | Call):
            return self._flow.leave(line)
        elif isinstance(line, Choice):
            return await self._choose(line)
        elif isinstance(line, Wait):
            await self._wait(line)
        elif isinstance(line, Input):
            await self._input(line)
        elif isinstance(line, Block):
            return await self._block(line)
        return None

    async def _command(self, wanted: Statement) -> None:
        if wanted.word in ("START", "CUT"):
            self._asks(self, wanted)
        elif wanted.word in MOTIONS:
            await self._move(wanted)
        elif wanted.word in POWERS:
            await self._operate(self._handlers.power(wanted, self._scope))
        elif not self._handlers.set(wanted, self._scope):
            raise Refusal(Code.ILLEGAL_COMMAND)

    async def _move(self, wanted: Statement) -> None:
        machine = self._machine
        await self._until_arm_stands(blends=True)
        if self._stopped_by is not None:
            return
        if self._resumes_at is not None:
            given, to = Given(machine.motions.full_pace()), self._resumes_at
            self._resumes_at = None
            await self._operate(machine.motions.one(machine.motions.start(Go(to), given), given))
        else:
            await self._operate(self._handlers.motion(wanted, self._scope, Kind.STEP))
        if self._stopped_by is not None and wanted.word in RELATIVE and machine.motions.last is not None:
            self._resumes_at = machine.motions.last.end  # the same again from here would go too far

    async def _operate(self, work: Work) -> None:
        self._operation = Operation(self._machine.clock, None, moves=True)
        try:
            ending = await work(self._operation)
        finally:
            self._operation = None
        if ending is not None and self._stopped_by is None:
            raise Refusal(ending)

    async def _until_arm_stands(self, *, blends: bool) -> None:
        """Another task may move it, or the last motion with CONT is not quite over."""
        machine = self._machine
        while self._stopped_by is None and machine.arm.moving_at(machine.clock.now()):
            if blends and machine.motions.last_blends:
                return
            await self._pause(LOOK_AGAIN_S)

    async def _pause(self, for_s: float) -> None:
        self._operation = Operation(self._machine.clock, None, moves=False)
        try:
            await self._operation.until(self._machine.clock.now() + for_s)
        finally:
            self._operation = None

    async def _choose(self, line: Choice) -> int | None:
        for inner in line.then if self._flow.is_true(line.condition) else line.otherwise:
            next_at = await self._execute(inner)
            if next_at is not None or self._stopped_by is not None:
                return next_at
        return None

    async def _wait(self, line: Wait) -> None:
        machine = self._machine
        if line.condition is None:
            await self._until_arm_stands(blends=False)
            return
        at_most_ms = integer(line.at_most(self._scope), 0, LONGEST_WAIT_MS) if line.at_most else None
        until_s = None if at_most_ms is None else machine.clock.now() + at_most_ms / 1000
        machine.timed_out = False
        while self._stopped_by is None and not self._flow.is_true(line.condition):
            if until_s is not None and machine.clock.now() >= until_s:
                machine.timed_out = True
                return
            await self._pause(LOOK_AGAIN_S)

    async def _input(self, line: Input) -> None:
        dialogue = self._machine.dialogue
        dialogue.ask(self.number, line.prompt(self._scope) if line.prompt is not None else None)
        while (answer := dialogue.take(self.number)) is None:
            if self._stopped_by is not None:
                dialogue.forget(self.number)
                return
            await self._pause(LOOK_AGAIN_S)
        values = pieces(answer)
        if len(values) != len(line.targets):
            raise Refusal(Code.INPUT_FORMAT)
        for target, text in zip(line.targets, values, strict=True):
            self._handlers.assign(told(target, text), self._scope)

    async def _block(self, line: Block) -> int | None:
        if line.word == "DELAY":
            await self._pause(integer(line.expressions[0](self._scope), 1, LONGEST_WAIT_MS) / 1000)
        elif line.word in OTHERS:
            self._asks(self, line)
            return self._flow.at + 1
        elif line.word == "PRINT":
            values = [each(self._scope) for each in line.expressions]
            self._machine.dialogue.say(self.number, values)
        elif line.word == "DIM":
            sizes = tuple(integer(size(self._scope)) for size in line.expressions)
            self._scope.home(line.variable).dimension(line.variable, sizes)
        return self._flow.block(line)

    # -- details -----------------------------------------------------------------------------------------

    def _end(self) -> None:
        if self._stopped_by is None:
            self._machine.report(Code.ENDED_BY_HALT)
            self.reset()
        else:
            self._machine.report(self._stopped_by, self._flow.line_number)

    def _to_state(self, state: str) -> None:
        self.state = state
        name = self.program.source.name
        self._machine.log.add("program", task=self.number, name=name, state=state, line=self._flow.line_number)
