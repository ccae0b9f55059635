"""The programs that are stored, the tasks that they are loaded into, and the commands about both."""

import asyncio
from collections.abc import Callable, Coroutine

from simulators.robot.codes import Code, Refusal
from simulators.robot.handlers import Handlers
from simulators.robot.language.names import ProgramCommand
from simulators.robot.language.nodes import Block, Statement
from simulators.robot.language.program import Source, compiled
from simulators.robot.machine import Machine
from simulators.robot.refusals import Kind
from simulators.robot.tasks import RUNS, Task

MAIN_TASK, HIGHEST_TASK = 1, 16
MOST_PROGRAMS = 100
STOPPED_BY = {"HOLD": Code.STOPPED_BY_HOLD, "HOLDALL": Code.STOPPED_BY_HOLDALL, "HALTALL": Code.ENDED_BY_HALTALL}


class Programs:
    """`spawn` runs a coroutine until the controller is switched off."""

    def __init__(
        self, machine: Machine, handlers: Handlers, spawn: Callable[[Coroutine[None, None, None]], asyncio.Task[None]]
    ) -> None:
        self.sources: dict[str, Source] = {}
        self.tasks: dict[int, Task] = {}
        self._machine, self._handlers, self._spawn = machine, handlers, spawn
        machine.running = lambda: any(task.state == RUNS for task in self.tasks.values())
        machine.at_start = lambda: all(task.at_start for task in self.tasks.values())
        machine.stop_programs = self.stop_all

    def commands(self) -> dict[str, Callable[[ProgramCommand], None]]:
        """By word."""
        return {"LOAD": self.load, "RUN": self.run, "STOP": self.stop, "RESET": self.reset}

    def store(self, source: Source) -> None:
        """Keep a program, in the place of one of the same name; raises Refusal."""
        self._machine.permit(Kind.PROGRAM)
        if source.name not in self.sources and len(self.sources) >= MOST_PROGRAMS:
            raise Refusal(Code.MEMORY_FULL)
        self.sources[source.name] = source

    def load(self, wanted: ProgramCommand) -> None:
        """Into a task, checked; raises Refusal."""
        self._machine.permit(Kind.PROGRAM)
        self._load(self._source(wanted), wanted.task)

    def run(self, wanted: ProgramCommand) -> None:
        """Begin, or go on where it was stopped; raises Refusal."""
        self._machine.permit(Kind.RUN)
        if wanted.name is not None or wanted.number is not None:
            self._load(self._source(wanted), wanted.task)
        self._begin(self._task(wanted))

    def stop(self, wanted: ProgramCommand) -> None:
        """All tasks, or one; raises Refusal."""
        for task in [self._task(wanted)] if wanted.task is not None else list(self.tasks.values()):
            if task.state == RUNS:
                task.stop(Code.STOPPED)

    def stop_all(self, code: Code) -> None:
        """Because of an alarm."""
        for task in self.tasks.values():
            if task.state == RUNS:
                task.stop(code)

    def reset(self, wanted: ProgramCommand) -> None:
        """To the first statement; raises Refusal."""
        self._machine.permit(Kind.RESET)
        for task in [self._task(wanted)] if wanted.task is not None else self.tasks.values():
            task.reset()

    def monitor(self, wanted: ProgramCommand) -> str:
        """Program, line, state, priority of a task; raises Refusal."""
        number = _task_number(wanted.task)
        task = self.tasks.get(number)
        if task is None:
            return "0,0,S,32"
        return f"{task.program.source.name},{task.line_number},{task.state},{task.priority}"

    def _source(self, wanted: ProgramCommand) -> Source:
        for source in self.sources.values():
            if source.name == wanted.name or (wanted.number is not None and source.number == wanted.number):
                return source
        raise Refusal(Code.PROGRAM_MISSING)

    def _load(self, source: Source, number: int | None) -> Task:
        number = _task_number(number)
        program = compiled(source, self._machine.dialect.words)
        self.tasks[number] = Task(number, program, self._machine, self._handlers, self._asked)
        return self.tasks[number]

    def _task(self, wanted: ProgramCommand) -> Task:
        number = _task_number(wanted.task)
        if number not in self.tasks:
            raise Refusal(Code.NO_CURRENT_PROGRAM if wanted.task is None else Code.TASK_MISSING)
        return self.tasks[number]

    def _begin(self, task: Task) -> None:
        if task.state == RUNS:
            raise Refusal(Code.PROGRAM_RUNNING)
        task.begin()
        self._spawn(task.run())

    def _asked(self, task: Task, line: Statement | Block) -> None:
        """A program's wish about tasks."""
        if isinstance(line, Block):
            for each in self.tasks.values() if line.word.endswith("ALL") else [task]:
                each.stop(STOPPED_BY.get(line.word, Code.TERMINATED_BY_EXIT_TASK))
            return
        wanted = line.argument
        assert isinstance(wanted, ProgramCommand)
        if line.word == "START":
            running = self.tasks.get(_task_number(wanted.task))
            if running is not None and running.state == RUNS:
                raise Refusal(Code.TASK_RUNNING)
            self._begin(self._load(self._source(wanted), wanted.task))
        else:
            self._task(wanted).stop(Code.TERMINATED_BY_CUT)


def _task_number(number: int | None) -> int:
    if number is None:
        return MAIN_TASK
    if not 1 <= number <= HIGHEST_TASK:
        raise Refusal(Code.TASK_NUMBER)
    return number
