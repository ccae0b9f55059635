"""What a line can be. Pure."""

from collections.abc import Callable
from dataclasses import dataclass

from simulators.robot.codes import Code
from simulators.robot.language.assignments import Assignment, Target
from simulators.robot.language.values import Expression

Arguments = dict[str, tuple[str, Callable[[str], object]]]  # word -> its other name, and what reads its argument


@dataclass(frozen=True, slots=True)
class Statement:
    """A command: what it is called in both generations, and its argument."""

    word: str
    argument: object = None


@dataclass(frozen=True, slots=True)
class Label:
    """A place to go to."""

    name: str


@dataclass(frozen=True, slots=True)
class Jump:
    """GOTO and GOSUB."""

    label: str
    comes_back: bool = False


@dataclass(frozen=True, slots=True)
class Call:
    """CALL of a SUB with its arguments."""

    name: str
    arguments: tuple[Expression, ...] = ()


@dataclass(frozen=True, slots=True)
class Input:
    """INPUT: what is asked, and what the answer is put into."""

    prompt: Expression | None
    targets: tuple[Target, ...]


@dataclass(frozen=True, slots=True)
class Choice:
    """IF condition THEN ... ELSE ... on one line."""

    condition: Expression
    then: tuple["Line", ...]
    otherwise: tuple["Line", ...]


@dataclass(frozen=True, slots=True)
class Block:
    """A word that opens, continues or closes a block: IF, ELSEIF, ELSE, ENDIF, FOR, NEXT, WHILE, WEND, SELECT, SUB ...

    `names` are the parameters of a SUB, or what it shares.
    """

    word: str
    expressions: tuple[Expression, ...] = ()
    variable: str = ""
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Wait:
    """WAIT for a condition, at most so many ms; without a condition for the arm to stand."""

    condition: Expression | None
    at_most: Expression | None = None


Line = Statement | Assignment | Label | Jump | Call | Input | Choice | Block | Wait

# What a block's part lacks when its first or its last part is missing.
WITHOUT_OPENING = {
    "ELSEIF": Code.ELSE_WITHOUT_IF,
    "ELSE": Code.ELSE_WITHOUT_IF,
    "CASE": Code.CASE_WITHOUT_SELECT,
    "CASE ELSE": Code.CASE_WITHOUT_SELECT,
    "ENDIF": Code.ENDIF_WITHOUT_IF,
    "WEND": Code.WEND_WITHOUT_WHILE,
    "NEXT": Code.NEXT_WITHOUT_FOR,
    "END SELECT": Code.END_SELECT_WITHOUT_SELECT,
    "END SUB": Code.END_SUB_WITHOUT_SUB,
}
WITHOUT_CLOSING = {
    "IF": Code.IF_WITHOUT_ENDIF,
    "WHILE": Code.WHILE_WITHOUT_WEND,
    "FOR": Code.FOR_WITHOUT_NEXT,
    "SELECT": Code.SELECT_WITHOUT_END_SELECT,
    "SUB": Code.SUB_WITHOUT_END_SUB,
}
