"""Where a running program is: its next statement, what it will return to, its loops."""

from collections.abc import Callable

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.nodes import Block, Jump, Line
from simulators.robot.language.program import Program
from simulators.robot.language.values import Expression, PointData, Scope, Value, number

DEEPEST = 32


class Flow:
    """`set_variable` assigns a loop's variable."""

    def __init__(self, program: Program, scope: Scope, set_variable: Callable[[str, Value], None]) -> None:
        self.program, self._scope, self._set = program, scope, set_variable
        self.at = 0
        self._returns: list[int] = []
        self._loops: dict[int, tuple[float, float]] = {}  # by the place of FOR: last value and step
        self._blocks: dict[str, Callable[[Block], int]] = {
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
        self._returns.clear()
        self._loops.clear()

    def jump(self, line: Jump) -> int:
        """GOTO, GOSUB."""
        if line.comes_back:
            if len(self._returns) >= DEEPEST:
                raise Refusal(Code.STACK_OVERFLOW)
            self._returns.append(self.at + 1)
        return self.program.labels[line.label]

    def block(self, line: Block) -> int | None:
        """Where this part of a block leads; None for the statement behind it. Raises Refusal."""
        follow = self._blocks.get(line.word)
        return follow(line) if follow is not None else None

    def is_true(self, expression: Expression) -> bool:
        """A condition."""
        return number(expression(self._scope)) != 0

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
        self._loops[self.at] = float(last), float(by)
        self._set(line.variable, first)
        return self.at + 1 if _goes_on(first, last, by) else self.program.close[self.at] + 1

    def _next(self, line: Block) -> int:
        opening = self.program.opens[self.at]
        begun = self._part(opening)
        if opening not in self._loops:
            raise Refusal(Code.NEXT_WITHOUT_FOR)
        last, by = self._loops[opening]
        value = number(self._scope.variable(begun.variable, ())) + by
        self._set(begun.variable, value)
        return opening + 1 if _goes_on(value, last, by) else self.at + 1

    def _return(self) -> int:
        if not self._returns:
            raise Refusal(Code.RETURN_WITHOUT_GOSUB)
        return self._returns.pop()

    def _part(self, at: int) -> Block:
        part = self.program.steps[at][1]
        assert isinstance(part, Block)
        return part


def _goes_on(value: float, last: float, by: float) -> bool:
    return value <= last if by >= 0 else value >= last


def _equal(a: Value, b: Value) -> bool:
    return not isinstance(a, PointData) and not isinstance(b, PointData) and a == b
