"""Characters to tokens, and a reader that takes them one by one. Pure."""

import re
from typing import NamedTuple

from simulators.robot.codes import Code, Refusal

TOKEN = re.compile(
    r"""(?P<blank>[ \t]+)|(?P<text>"[^"]*"?)
    |(?P<number>&B[01]+|&H[0-9A-F]+|\d+(?:\.\d*)?|\.\d+)
    |(?P<name>[A-Z_][A-Z0-9_]*[%!$]?)
    |(?P<sign><=|=<|>=|=>|<>|><|[-+*/^=<>()\[\]{},:;'@?~])
    |(?P<odd>.)""",
    re.ASCII | re.VERBOSE | re.DOTALL,
)
DIGITS = 9
LONGEST = 4096


class Token(NamedTuple):
    """`kind` is text, number, name, sign, odd or end; `at` and `to` are where it stands in the line."""

    kind: str
    text: str
    at: int
    to: int


def tokens_of(line: str) -> list[Token]:
    """The tokens of a line without its blanks. A comment ends it."""
    found = []
    for match in TOKEN.finditer(line[:LONGEST]):
        if match.lastgroup != "blank":
            found.append(Token(match.lastgroup or "odd", match[0], match.start(), match.end()))
        if match[0] == "'":
            found.pop()
            break
    return found


def upper(line: str) -> str:
    """In capital letters, but for what stands in quotes."""
    pieces = line.split('"')
    return '"'.join(piece if k % 2 else piece.translate(CAPITALS) for k, piece in enumerate(pieces))


CAPITALS = {small: small - 32 for small in range(ord("a"), ord("z") + 1)}


class Reader:
    """The rest of a line. Methods raise Refusal SYNTAX where the text is not what they want."""

    def __init__(self, line: str, *, at: int = 0) -> None:
        self.line = line
        self._tokens = [token for token in tokens_of(line) if token.at >= at]
        self._index = 0

    @property
    def token(self) -> Token:
        """The next token, of kind "end" when there is none."""
        if self._index < len(self._tokens):
            return self._tokens[self._index]
        return Token("end", "", len(self.line), len(self.line))

    @property
    def ended(self) -> bool:
        """Whether nothing is left."""
        return self._index >= len(self._tokens)

    def rest(self) -> str:
        """What is left, as it was written."""
        return self.line[self.token.at :] if not self.ended else ""

    def take(self) -> Token:
        """The next token."""
        token = self.token
        self._index += 1
        return token

    def accept(self, *texts: str) -> bool:
        """Take the next token if it is one of these."""
        if self.token.text in texts and self.token.kind != "text" and not self.ended:
            self._index += 1
            return True
        return False

    def expect(self, text: str) -> None:
        """Take this token."""
        if not self.accept(text):
            raise Refusal(Code.SYNTAX)

    def name(self) -> str:
        """Take a name."""
        if self.token.kind != "name":
            raise Refusal(Code.SYNTAX)
        return self.take().text

    def end(self) -> None:
        """Nothing may be left."""
        if not self.ended:
            raise Refusal(Code.SYNTAX)

    def remaining(self) -> list[Token]:
        """The tokens that are left; none is taken."""
        return self._tokens[self._index :]

    def mark(self) -> int:
        """A place to come back to."""
        return self._index

    def back(self, mark: int) -> None:
        """Come back to it."""
        self._index = mark


def number_of(text: str) -> int | float:
    """The value of a number token: a whole number unless it has a point. Raises Refusal NUMBER when too long."""
    if text.startswith("&"):
        if len(text) > 34:
            raise Refusal(Code.NUMBER)
        value = int(text[2:], 2 if text[1] == "B" else 16)
        return value - (1 << 32) if 1 << 31 <= value < 1 << 32 else value
    if len(text) > 2 * DIGITS + 1 or len(text.partition(".")[0]) > DIGITS:
        raise Refusal(Code.NUMBER)
    return float(text) if "." in text else int(text)
