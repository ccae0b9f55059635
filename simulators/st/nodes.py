"""The syntax tree. Names are as written; they are compared without regard to case. Pure."""

from dataclasses import dataclass

from simulators.st.errors import Spot
from simulators.st.types import Type


@dataclass(frozen=True, slots=True)
class Literal:
    """A value; a plain integer has no type of its own."""

    spot: Spot
    value: int | bool
    type: Type


@dataclass(frozen=True, slots=True)
class Name:
    """`variable`, or `instance.output`."""

    spot: Spot
    parts: tuple[str, ...]

    def __str__(self) -> str:
        return ".".join(self.parts)


@dataclass(frozen=True, slots=True)
class Unary:
    """NOT or -."""

    spot: Spot
    sign: str
    operand: "Expression"


@dataclass(frozen=True, slots=True)
class Binary:
    """Two operands; `spot` is the operator's."""

    spot: Spot
    sign: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True, slots=True)
class Argument:
    """`name := value`, a value alone (its name is empty), or `name => target`."""

    spot: Spot
    name: str
    value: "Expression"
    out: bool = False


@dataclass(frozen=True, slots=True)
class Call:
    """Of a function, as an expression."""

    spot: Spot
    name: str
    arguments: tuple[Argument, ...]


Expression = Literal | Name | Unary | Binary | Call


@dataclass(frozen=True, slots=True)
class Assign:
    """target := value."""

    target: Name
    value: Expression


@dataclass(frozen=True, slots=True)
class Invoke:
    """Of a function block's instance."""

    instance: Name
    arguments: tuple[Argument, ...]


@dataclass(frozen=True, slots=True)
class If:
    """IF and every ELSIF with their bodies, and ELSE."""

    branches: tuple[tuple[Expression, "Body"], ...]
    otherwise: "Body"


@dataclass(frozen=True, slots=True)
class Case:
    """Labels with their bodies, and ELSE."""

    spot: Spot
    subject: Expression
    branches: tuple[tuple[tuple[Literal, ...], "Body"], ...]
    otherwise: "Body"


Statement = Assign | Invoke | If | Case
Body = tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Variable:
    """One declared variable. `section` is VAR, VAR_INPUT or VAR_OUTPUT; `address` is empty when it has none."""

    spot: Spot
    name: str
    section: str
    type_name: str
    type_spot: Spot
    initial: Literal | None
    constant: bool = False
    retain: bool = False
    address: str = ""


@dataclass(frozen=True, slots=True)
class Unit:
    """A FUNCTION (with the name of its result's type), FUNCTION_BLOCK or PROGRAM."""

    spot: Spot
    kind: str
    name: str
    result: str
    variables: tuple[Variable, ...]
    body: Body
