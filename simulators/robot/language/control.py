"""The lines of a program: statements, labels, and what decides which comes next. Pure."""

from collections.abc import Callable

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.assignments import whole_target
from simulators.robot.language.commands import pieces
from simulators.robot.language.expressions import expression, read_expression
from simulators.robot.language.names import program_command
from simulators.robot.language.nodes import (
    WITHOUT_CLOSING,
    WITHOUT_OPENING,
    Arguments,
    Block,
    Call,
    Choice,
    Input,
    Jump,
    Label,
    Line,
    Statement,
    Wait,
)
from simulators.robot.language.statements import statement
from simulators.robot.language.tokens import Reader
from simulators.robot.language.values import Expression


def lines(text: str, words: Arguments) -> list[Line]:
    """All statements of one line of a program; raises Refusal."""
    found: list[Line] = []
    for part in _parts(text):
        reader = Reader(part)
        if reader.accept("*"):
            found.append(Label(reader.name()))
            reader.accept(":")
            reader.end()
        elif not reader.ended:
            found.append(_line(part, reader, words))
    return found


def _line(part: str, reader: Reader, words: Arguments) -> Line:
    word = reader.token.text if reader.token.kind == "name" else ""
    control = CONTROLS.get(word)
    if control is not None and not _is_assigned(reader):
        reader.take()
        return control(reader, words)
    return statement(part, words)


def _is_assigned(reader: Reader) -> bool:
    mark = reader.mark()
    reader.take()
    assigned = reader.accept("=")
    reader.back(mark)
    return assigned


def _parts(text: str) -> list[str]:
    """A line's statements: colons part them, but not behind IF, whose branches are its own."""
    found, begun = [], 0
    for token in Reader(text).remaining():
        if token.text in ("IF", "REM") and not text[begun : token.at].strip():
            break
        if token.text == ":":
            found.append(text[begun : token.at])
            begun = token.to
    return [*found, text[begun:]]


def _goto(reader: Reader, words: Arguments) -> Line:
    return Jump(_label(reader))


def _gosub(reader: Reader, words: Arguments) -> Line:
    return Jump(_label(reader), comes_back=True)


def _label(reader: Reader) -> str:
    reader.expect("*")
    name = reader.name()
    reader.end()
    return name


def _if(reader: Reader, words: Arguments) -> Line:
    condition = read_expression(reader)
    if reader.ended:
        return Block("IF", (condition,))
    reader.expect("THEN")
    if reader.ended:
        return Block("IF", (condition,))
    text = reader.rest()
    otherwise = next((token for token in Reader(text).remaining() if token.text == "ELSE"), None)
    then = text[: otherwise.at] if otherwise else text
    last = text[otherwise.to :] if otherwise else ""
    return Choice(condition, _branch(then, words), _branch(last, words) if otherwise else ())


def _branch(text: str, words: Arguments) -> tuple[Line, ...]:
    reader = Reader(text)
    if reader.accept("*"):
        name = reader.name()
        reader.end()
        return (Jump(name),)
    found = tuple(lines(text, words))
    if not found or any(isinstance(line, Label) or _opens_or_closes(line) for line in found):
        raise Refusal(Code.SYNTAX)
    return found


def _opens_or_closes(line: Line) -> bool:
    return isinstance(line, Block) and (line.word in WITHOUT_CLOSING or line.word in WITHOUT_OPENING)


def _conditional(word: str) -> Callable[[Reader, Arguments], Line]:
    def read(reader: Reader, words: Arguments) -> Line:
        condition = read_expression(reader)
        if word == "ELSEIF":
            reader.accept("THEN")
        reader.end()
        return Block(word, (condition,))

    return read


def _alone(word: str) -> Callable[[Reader, Arguments], Line]:
    def read(reader: Reader, words: Arguments) -> Line:
        reader.end()
        return Block(word)

    return read


def _ending(word: str) -> Callable[[Reader, Arguments], Line]:
    """HALT, HOLD: a text behind it is for the display."""

    def read(reader: Reader, words: Arguments) -> Line:
        if not reader.ended:
            expression(reader.rest())
        return Block(word)

    return read


def _end(reader: Reader, words: Arguments) -> Line:
    if reader.accept("IF"):
        return Block("ENDIF")
    if reader.accept("SELECT"):
        return Block("END SELECT")
    if reader.accept("SUB"):
        return Block("END SUB")
    reader.end()
    return Block("HALT")


def _exit(reader: Reader, words: Arguments) -> Line:
    if reader.accept("FOR"):
        return Block("EXIT FOR")
    if reader.accept("TASK"):
        return Block("EXIT TASK")
    if reader.accept("SUB"):
        return Block("EXIT SUB")
    raise Refusal(Code.SYNTAX)


def _for(reader: Reader, words: Arguments) -> Line:
    variable = reader.name()
    reader.expect("=")
    first = read_expression(reader)
    reader.expect("TO")
    last = read_expression(reader)
    by: Expression = read_expression(reader) if reader.accept("STEP") else lambda scope: 1
    reader.end()
    return Block("FOR", (first, last, by), variable)


def _next(reader: Reader, words: Arguments) -> Line:
    return Block("NEXT", variable="" if reader.ended else reader.name())


def _select(reader: Reader, words: Arguments) -> Line:
    reader.accept("CASE")
    found = read_expression(reader)
    reader.end()
    return Block("SELECT", (found,))


def _case(reader: Reader, words: Arguments) -> Line:
    if reader.accept("ELSE"):
        return Block("CASE ELSE")
    return Block("CASE", tuple(expression(piece) for piece in pieces(reader.rest())))


def _wait(reader: Reader, words: Arguments) -> Line:
    if reader.accept("ARM"):
        return Wait(None)
    condition, *limit = pieces(reader.rest())
    if len(limit) > 1:
        raise Refusal(Code.SYNTAX)
    return Wait(expression(condition), expression(limit[0]) if limit else None)


def _delay(reader: Reader, words: Arguments) -> Line:
    return Block("DELAY", (expression(reader.rest()),))


def _dim(reader: Reader, words: Arguments) -> Line:
    name = reader.name()
    reader.expect("(")
    sizes = []
    while not reader.accept(")"):
        sizes.append(read_expression(reader))
        if not reader.accept(","):
            reader.expect(")")
            break
    reader.end()
    return Block("DIM", tuple(sizes), name)


def _print(reader: Reader, words: Arguments) -> Line:
    return Block("PRINT", tuple(expression(piece) for piece in pieces(reader.rest()) if piece))


def _call(reader: Reader, words: Arguments) -> Line:
    reader.expect("*")
    name = reader.name()
    return Call(name, tuple(expression(piece) for piece in _in_brackets(reader)))


def _sub(reader: Reader, words: Arguments) -> Line:
    reader.expect("*")
    name = reader.name()
    return Block("SUB", variable=name, names=tuple(_names(_in_brackets(reader))))


def _in_brackets(reader: Reader) -> list[str]:
    """What stands in brackets up to the end of the line; nothing when there are none."""
    if reader.ended:
        return []
    reader.expect("(")
    inside = reader.rest().rstrip()
    if not inside.endswith(")"):
        raise Refusal(Code.SYNTAX)
    return pieces(inside[:-1])


def _names(parts: list[str]) -> list[str]:
    found = []
    for part in parts:
        reader = Reader(part.removesuffix("()"))
        found.append(reader.name())
        reader.end()
    return found


def _shared(reader: Reader, words: Arguments) -> Line:
    return Block("SHARED", names=tuple(_names(pieces(reader.rest()))))


def _on(reader: Reader, words: Arguments) -> Line:
    reader.expect("ERROR")
    reader.expect("GOTO")
    if reader.accept("0"):
        reader.end()
        return Block("ON ERROR")
    return Block("ON ERROR", variable=_label(reader))


def _resume(reader: Reader, words: Arguments) -> Line:
    if reader.ended:
        return Block("RESUME")
    if reader.accept("NEXT"):
        reader.end()
        return Block("RESUME NEXT")
    return Block("RESUME", variable=_label(reader))


def _input(reader: Reader, words: Arguments) -> Line:
    prompt: Expression | None = None
    if reader.token.kind == "text":
        prompt = read_expression(reader)
        if not reader.accept(","):
            reader.expect(";")
    return Input(prompt, tuple(whole_target(piece) for piece in pieces(reader.rest())))


def _task(word: str) -> Callable[[Reader, Arguments], Line]:
    return lambda reader, words: Statement(word, program_command(reader.rest()))


CONTROLS: dict[str, Callable[[Reader, Arguments], Line]] = {
    "GOTO": _goto,
    "GOSUB": _gosub,
    "RETURN": _alone("RETURN"),
    "IF": _if,
    "ELSEIF": _conditional("ELSEIF"),
    "ELSE": _alone("ELSE"),
    "ENDIF": _alone("ENDIF"),
    "END": _end,
    "FOR": _for,
    "NEXT": _next,
    "WHILE": _conditional("WHILE"),
    "WEND": _alone("WEND"),
    "SELECT": _select,
    "CASE": _case,
    "EXIT": _exit,
    "HALT": _ending("HALT"),
    "HALTALL": _ending("HALTALL"),
    "HOLD": _ending("HOLD"),
    "HOLDALL": _ending("HOLDALL"),
    "WAIT": _wait,
    "DELAY": _delay,
    "DIM": _dim,
    "PRINT": _print,
    "INPUT": _input,
    "CALL": _call,
    "SUB": _sub,
    "SHARED": _shared,
    "ON": _on,
    "RESUME": _resume,
    "START": _task("START"),
    "CUT": _task("CUT"),
    "REM": lambda reader, words: Block("REM"),
}
