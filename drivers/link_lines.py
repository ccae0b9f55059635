"""Bytes to lines, and the telnet negotiation that may be between them. Pure."""

LONGEST_LINE = 512
IAC, DONT, DO, WONT, WILL, SUBNEGOTIATION, SUBNEGOTIATION_END = 255, 254, 253, 252, 251, 250, 240


class LineSplitter:
    """Bytes to lines, pure. NUL and CR are dropped, LF ends a line, telnet negotiation is swallowed and refused."""

    def __init__(self, *, telnet: bool) -> None:
        self.overlong = False  # a line passed LONGEST_LINE; nothing after it can be trusted
        self._telnet = telnet
        self._begun = bytearray()
        self._negotiation = bytearray()

    def feed(self, data: bytes) -> tuple[list[str], bytes]:
        """The whole lines that these bytes complete, and the bytes to send back at once."""
        refusals = b""
        if self._telnet and (self._negotiation or IAC in data):
            data, refusals = self._without_negotiation(data)
        *ended, begun = data.translate(None, b"\0\r").split(b"\n")
        lines = []
        for piece in ended:
            lines.append(bytes(self._begun + piece))
            self._begun.clear()
        self._begun += begun
        self.overlong = self.overlong or any(len(line) > LONGEST_LINE for line in (*lines, self._begun))
        del self._begun[LONGEST_LINE + 1 :]
        return [line.decode("latin-1") for line in lines], refusals

    def _without_negotiation(self, data: bytes) -> tuple[bytes, bytes]:
        plain, refusals = bytearray(), bytearray()
        for byte in data:
            if not self._negotiation and byte != IAC:
                plain.append(byte)
                continue
            self._negotiation.append(byte)
            if self._negotiation_ended():
                refusals += _refusal(self._negotiation)
                plain += _not_telnet(self._negotiation)
                self._negotiation.clear()
        return bytes(plain), bytes(refusals)

    def _negotiation_ended(self) -> bool:
        told = self._negotiation
        if len(told) == 1:
            return False
        if told[1] == SUBNEGOTIATION:
            del told[2:-2]  # its content is nothing to us
            return len(told) == 4 and told[2:] == bytes((IAC, SUBNEGOTIATION_END))
        return len(told) == 3 or told[1] not in (WILL, WONT, DO, DONT)


def _not_telnet(told: bytearray) -> bytes:
    """A stray FFh takes no letter and no line end with it."""
    return bytes(told[1:]) if told[1] < SUBNEGOTIATION_END else b""


def _refusal(told: bytearray) -> bytes:
    answer = {WILL: DONT, DO: WONT}.get(told[1])
    return bytes((IAC, answer, told[2])) if answer is not None else b""
