"""The tokens of a program, taken one by one. Pure."""

from collections.abc import Iterator
from contextlib import contextmanager

from simulators.st.errors import StError
from simulators.st.tokens import Token, tokens_of

DEEPEST = 40  # nested parentheses and statements; both limits keep us off Python's own
MOST_OPERATORS = 80  # of one statement


class Reader:
    """What is left of a program. Methods raise StError where the text is not what they want."""

    def __init__(self, source: str) -> None:
        self._tokens = tokens_of(source)
        self._at = 0
        self._depth = 0
        self.operators = 0  # in the statement so far

    @property
    def token(self) -> Token:
        """The next token, of kind end when there is none."""
        return self._tokens[self._at]

    @property
    def after(self) -> Token:
        """The token after the next."""
        return self._tokens[min(self._at + 1, len(self._tokens) - 1)]

    def take(self) -> Token:
        """The next token, which is then gone."""
        token = self.token
        self._at += token.kind != "end"
        return token

    def sees(self, *texts: str) -> bool:
        """Whether the next token is one of these keywords or signs."""
        return self.token.kind in ("keyword", "sign") and self.token.text in texts

    def accept(self, text: str) -> bool:
        """Take this keyword or sign if it is next."""
        seen = self.sees(text)
        if seen:
            self.take()
        return seen

    def expect(self, text: str, where: str) -> Token:
        """Take this keyword or sign."""
        if not self.sees(text):
            raise self.wrong(f"{text} {where}")
        return self.take()

    def name(self, what: str) -> Token:
        """Take an identifier."""
        if self.token.kind != "name":
            raise self.wrong(what)
        return self.take()

    def literal(self, what: str) -> Token:
        """Take a number or a literal."""
        if self.token.kind not in ("number", "literal"):
            raise self.wrong(what)
        return self.take()

    def operator(self) -> Token:
        """Take an operator; a statement has so many of them at most."""
        self.operators += 1
        if self.operators > MOST_OPERATORS:
            raise StError(self.token.spot, f"more than {MOST_OPERATORS} operators in one statement; split it")
        return self.take()

    def wrong(self, wanted: str) -> StError:
        """That something else was wanted here."""
        return StError(self.token.spot, f"{wanted} is needed here (got {self.token.text})")

    @contextmanager
    def nested(self) -> Iterator[None]:
        """One level deeper."""
        self._depth += 1
        if self._depth > DEEPEST:
            raise StError(self.token.spot, f"nested deeper than {DEEPEST} levels")
        yield
        self._depth -= 1
