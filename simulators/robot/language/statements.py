"""One assignment or one command with its argument. Pure."""

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.assignments import Assignment, assignment
from simulators.robot.language.commands import pieces
from simulators.robot.language.names import port
from simulators.robot.language.nodes import Arguments, Statement
from simulators.robot.language.tokens import Reader


def statement(text: str, words: Arguments) -> Statement | Assignment:
    """One assignment or command; raises Refusal."""
    if "=" in text and (assigned := assignment(text)) is not None:
        return assigned
    reader = Reader(text)
    if reader.token.kind != "name" or reader.token.text not in words:
        raise Refusal(Code.NO_SUCH_COMMAND)
    word, read = words[reader.take().text]
    if reader.accept("["):  # the number of the robot
        _robot_one(reader)
    argument = reader.rest()
    if word == "RESET" and argument and "(" in argument:
        return Statement("RESET OUTPUT", tuple(port(piece) for piece in pieces(argument)))
    return Statement(word, read(argument))


def _robot_one(reader: Reader) -> None:
    if reader.take().text != "1":
        raise Refusal(Code.ROBOT_NUMBER)
    reader.expect("]")
