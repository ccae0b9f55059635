"""A program: its source, and its statements with everything that a jump needs. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.control import lines
from simulators.robot.language.nodes import (
    WITHOUT_CLOSING,
    WITHOUT_OPENING,
    Arguments,
    Block,
    Call,
    Choice,
    Jump,
    Label,
    Line,
)
from simulators.robot.language.tokens import upper

MOST_LINES = 9999
MOST_CHARACTERS = 255  # in a line
ALTERNATIVES = {"ELSEIF": "IF", "ELSE": "IF", "CASE": "SELECT", "CASE ELSE": "SELECT"}
CLOSES = {"ENDIF": "IF", "WEND": "WHILE", "NEXT": "FOR", "END SELECT": "SELECT", "END SUB": "SUB"}


@dataclass(frozen=True)
class Source:
    """A program as it was written. `number` is its PGN, None when it has not got one."""

    name: str
    number: int | None
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Program:
    """Statements with their line numbers (from 1), where labels are, and where blocks go on."""

    source: Source
    steps: tuple[tuple[int, Line], ...]
    labels: dict[str, int] = field(default_factory=dict)
    otherwise: dict[int, int] = field(default_factory=dict)  # from a block's part to its next part
    close: dict[int, int] = field(default_factory=dict)  # from a block's part to its end
    opens: dict[int, int] = field(default_factory=dict)  # from a block's end to its beginning
    loop: dict[int, int] = field(default_factory=dict)  # from EXIT FOR to its NEXT
    subs: dict[str, int] = field(default_factory=dict)  # where each SUB begins


def compiled(source: Source, words: Arguments) -> Program:
    """The program, checked as a whole; raises Refusal with the line."""
    steps: list[tuple[int, Line]] = []
    for number, text in enumerate(source.lines, 1):
        try:
            steps += ((number, line) for line in lines(upper(text), words))
        except Refusal as refusal:
            raise Refusal(refusal.code, number) from refusal
    program = Program(source, tuple(steps))
    _find_labels(program)
    _match_blocks(program)
    _check_jumps(program, steps)
    return program


def _find_labels(program: Program) -> None:
    for index, (number, line) in enumerate(program.steps):
        if isinstance(line, Label):
            if line.name in program.labels:
                raise Refusal(Code.DUPLICATE_LABEL, number)
            program.labels[line.name] = index
        elif isinstance(line, Block) and line.word == "SUB":
            if line.variable in program.subs:
                raise Refusal(Code.DUPLICATE_LABEL, number)
            program.subs[line.variable] = index


def _match_blocks(program: Program) -> None:
    open_blocks: list[list[int]] = []  # the indices of each block's parts so far
    for index, (number, line) in enumerate(program.steps):
        word = line.word if isinstance(line, Block) else ""
        if word in WITHOUT_CLOSING:
            open_blocks.append([index])
        elif word in WITHOUT_OPENING:
            _continue_block(program, open_blocks, index)
        elif _exits_loop(line):
            _exit_for(program, index, [parts[0] for parts in open_blocks if _word(program, parts[0]) == "FOR"], number)
    if open_blocks:
        first = open_blocks[-1][0]
        raise Refusal(WITHOUT_CLOSING[_word(program, first)], program.steps[first][0])
    for leave, opening in program.loop.items():
        program.loop[leave] = program.close[opening]


def _exits_loop(line: Line) -> bool:
    if isinstance(line, Choice):
        return any(_exits_loop(inner) for inner in (*line.then, *line.otherwise))
    return isinstance(line, Block) and line.word == "EXIT FOR"


def _continue_block(program: Program, open_blocks: list[list[int]], index: int) -> None:
    word = _word(program, index)
    wanted = ALTERNATIVES.get(word) or CLOSES[word]
    if not open_blocks or _word(program, open_blocks[-1][0]) != wanted:
        raise Refusal(WITHOUT_OPENING[word], program.steps[index][0])
    open_blocks[-1].append(index)
    if word in CLOSES:
        _close(program, open_blocks.pop())


def _word(program: Program, index: int) -> str:
    line = program.steps[index][1]
    return line.word if isinstance(line, Block) else ""


def _close(program: Program, parts: list[int]) -> None:
    end = parts[-1]
    program.opens[end] = parts[0]
    for part, following in pairwise(parts):
        program.otherwise[part] = following
        program.close[part] = end


def _exit_for(program: Program, index: int, loops: list[int], number: int) -> None:
    if not loops:
        raise Refusal(Code.EXIT_FOR_WITHOUT_FOR, number)
    program.loop[index] = loops[-1]


def _check_jumps(program: Program, steps: Iterable[tuple[int, Line]]) -> None:
    for number, line in steps:
        label = _label_of(line)
        if label and label not in program.labels:
            raise Refusal(Code.UNDEFINED_LABEL, number)
        if isinstance(line, Call):
            _check_call(program, line, number)
        if isinstance(line, Choice):
            _check_jumps(program, ((number, inner) for inner in (*line.then, *line.otherwise)))


def _label_of(line: Line) -> str:
    """Where a statement may go to, "" when it names no label."""
    if isinstance(line, Jump):
        return line.label
    return line.variable if isinstance(line, Block) and line.word in ("ON ERROR", "RESUME") else ""


def _check_call(program: Program, line: Call, number: int) -> None:
    begin = program.subs.get(line.name)
    if begin is None:
        raise Refusal(Code.UNDEFINED_IDENTIFIER, number)
    sub = program.steps[begin][1]
    if isinstance(sub, Block) and len(sub.names) != len(line.arguments):
        raise Refusal(Code.COMMAND_LINE, number)


def parse_source(name: str | None, written: list[str]) -> Source:
    """A program from the lines of an upload: NAME= and PGN= are its head. Raises Refusal."""
    number: int | None = None
    body: list[str] = []
    for text in written:
        head, equals, value = (part.strip() for part in upper(text).partition("="))
        if equals and head == "NAME" and not body:
            name = value.strip("<> ")
        elif equals and head == "PGN" and not body and value.isdecimal():
            number = int(value[:6])
        else:
            body.append(text.rstrip())
    if not name or len(name) > 32 or not name.replace("_", "").isalnum() or not name.isascii():
        raise Refusal(Code.PROGRAM_NAME)
    if len(body) > MOST_LINES or any(len(text) > MOST_CHARACTERS for text in body):
        raise Refusal(Code.PROGRAM_TOO_BIG)
    return Source(name, number, tuple(body))
