"""Where a running program is: its next statement, what it will return to, its loops, what it does about errors."""

from collections.abc import Callable
from dataclasses import dataclass, field

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.nodes import Block, Call, Jump, Line
from simulators.robot.language.program import Program
from simulators.robot.language.values import Expression, PointData, Value, number
from simulators.robot.task_scope import Own, TaskScope

DEEPEST = 32


@dataclass
class Level:
    """The main program, or one SUB that has been called: where it returns to, its GOSUBs, its loops."""

    calls_from: int = 0
    returns: list[int] = field(default_factory=list)
    loops: dict[int, tuple[float, float]] = field(default_factory=dict)  # by the place of FOR: last value and step


class Flow:
    """One place in one program."""

    def __init__(self, program: Program, scope: TaskScope) -> None:
        self.program, self._scope = program, scope
        self.at = 0
        self._levels = [Level()]
        self._trap: str | None = None  # the label of ON ERROR GOTO
        self._trapped_at: int | None = None
        self._blocks: dict[str, Callable[[Block], int | None]] = {
            "IF": self._if,
            "ELSEIF": self._behind_block,
            "ELSE": self._behind_block,
            "WHILE": self._while,
            "WEND": lambda line: self.program.opens[self.at],
            "FOR": self._for,
            "NEXT": self._next,
            "EXIT FOR": lambda line: self.program.loop[self.at] + 1,
            "SELECT": self._select,
            "CASE": self._behind_block,
            "CASE ELSE": self._behind_block,
            "RETURN": lambda line: self._return(),
            "END SUB": lambda line: self._end_sub(Code.END_SUB_WITHOUT_CALL),
            "EXIT SUB": lambda line: self._end_sub(Code.EXIT_SUB_WITHOUT_CALL),
            "SHARED": self._share,
            "ON ERROR": self._on_error,
            "RESUME": self._resume,
            "RESUME NEXT": self._resume,
            "HALT": lambda line: len(self.program.steps),
        }

    @property
    def line(self) -> Line | None:
        """The statement that comes next, None at the end."""
        return self.program.steps[self.at][1] if self.at < len(self.program.steps) else None

    @property
    def line_number(self) -> int:
        """Its number in the source, 0 before the first statement and behind the last."""
        return self.program.steps[self.at][0] if 0 < self.at < len(self.program.steps) else 0

    def reset(self) -> None:
        """To the first statement."""
        self.at = 0
        self._levels = [Level()]
        self._scope.own.clear()
        self._trap = self._trapped_at = self._scope.error = None

    def leave(self, line: Jump | Call) -> int:
        """GOTO, GOSUB, CALL. Raises Refusal."""
        if isinstance(line, Call):
            return self._call(line)
        if line.comes_back:
            if len(self._levels[-1].returns) >= DEEPEST:
                raise Refusal(Code.STACK_OVERFLOW)
            self._levels[-1].returns.append(self.at + 1)
        return self.program.labels[line.label]

    def trapped(self, error: Refusal) -> bool:
        """Go to where ON ERROR GOTO leads; False when nothing does, or this is an error of that very part."""
        if self._trap is None or self._trapped_at is not None:
            return False
        self._scope.error = Refusal(error.code, self.program.steps[self.at][0])
        self._trapped_at = self.at
        self.at = self.program.labels[self._trap]
        return True

    def block(self, line: Block) -> int | None:
        """Where this part of a block leads; None for the statement behind it. Raises Refusal."""
        follow = self._blocks.get(line.word)
        return follow(line) if follow is not None else None

    def is_true(self, expression: Expression) -> bool:
        """A condition."""
        return number(expression(self._scope)) != 0

    def _call(self, line: Call) -> int:
        """The arguments become variables of the SUB."""
        if len(self._levels) > DEEPEST:
            raise Refusal(Code.STACK_OVERFLOW)
        begin = self.program.subs[line.name]
        values = [argument(self._scope) for argument in line.arguments]
        own = Own()
        for name, value in zip(self._part(begin).names, values, strict=True):
            own.variables.set(name, (), value)
        self._scope.own.append(own)
        self._levels.append(Level(calls_from=self.at))
        return begin + 1

    def _if(self, line: Block) -> int:
        """On, or to the first part whose condition holds, or to the end."""
        at = self.at
        while part := self._part(at):
            if not part.expressions or self.is_true(part.expressions[0]):
                break
            at = self.program.otherwise[at]
        return at + 1

    def _while(self, line: Block) -> int:
        return self.at + 1 if self.is_true(line.expressions[0]) else self.program.close[self.at] + 1

    def _behind_block(self, line: Block) -> int:
        return self.program.close[self.at] + 1

    def _select(self, line: Block) -> int:
        wanted = line.expressions[0](self._scope)
        at = self.program.otherwise[self.at]
        while (part := self._part(at)).word == "CASE":
            if any(_equal(case(self._scope), wanted) for case in part.expressions):
                break
            at = self.program.otherwise[at]
        return at + 1

    def _for(self, line: Block) -> int:
        first, last, by = (number(each(self._scope)) for each in line.expressions)
        self._levels[-1].loops[self.at] = float(last), float(by)
        self._scope.set_variable(line.variable, (), first)
        return self.at + 1 if _goes_on(first, last, by) else self.program.close[self.at] + 1

    def _next(self, line: Block) -> int:
        opening = self.program.opens[self.at]
        begun = self._part(opening)
        loops = self._levels[-1].loops
        if opening not in loops:
            raise Refusal(Code.NEXT_WITHOUT_FOR)
        last, by = loops[opening]
        value = number(self._scope.variable(begun.variable, ())) + by
        self._scope.set_variable(begun.variable, (), value)
        return opening + 1 if _goes_on(value, last, by) else self.at + 1

    def _return(self) -> int:
        returns = self._levels[-1].returns
        if not returns:
            raise Refusal(Code.RETURN_WITHOUT_GOSUB)
        return returns.pop()

    def _end_sub(self, without_call: Code) -> int:
        if len(self._levels) == 1:
            raise Refusal(without_call)
        self._scope.own.pop()
        return self._levels.pop().calls_from + 1

    def _share(self, line: Block) -> None:
        if not self._scope.own:
            raise Refusal(Code.ILLEGAL_COMMAND)
        self._scope.own[-1].shared.update(line.names)

    def _on_error(self, line: Block) -> None:
        self._trap = line.variable or None

    def _resume(self, line: Block) -> int:
        """At the statement that went wrong, behind it, or at a label."""
        at, self._trapped_at = self._trapped_at, None
        if at is None:
            raise Refusal(Code.ILLEGAL_COMMAND)
        if line.variable:
            return self.program.labels[line.variable]
        return at + 1 if line.word == "RESUME NEXT" else at

    def _part(self, at: int) -> Block:
        part = self.program.steps[at][1]
        assert isinstance(part, Block)
        return part


def _goes_on(value: float, last: float, by: float) -> bool:
    return value <= last if by >= 0 else value >= last


def _equal(a: Value, b: Value) -> bool:
    return not isinstance(a, PointData) and not isinstance(b, PointData) and a == b
