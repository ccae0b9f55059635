"""Bytes to lines, control bytes that act at once, and telnet commands. Pure."""

from typing import NamedTuple

ETX, SYN, END_OF_FILE = 0x03, 0x16, 0x1A
CONTROLS = (ETX, SYN)
CR, LF = 0x0D, 0x0A
IAC, DONT, DO, WONT, WILL, SUBNEGOTIATION, INTERRUPT, SUBNEGOTIATION_END = 255, 254, 253, 252, 251, 250, 244, 240
KEPT_BYTES = 300  # of a line; more than any controller accepts
LONGEST_SUBNEGOTIATION = 64


class Negotiation(NamedTuple):
    """A client's WILL, WONT, DO or DONT."""

    verb: int
    option: int


Event = str | int | Negotiation


class Framer:
    """A line is a str without its end (CR, LF or both), a control byte an int that comes before the line it interrupts.

    NUL is nothing. FFh begins a telnet command; what follows an unknown one is text again.
    """

    def __init__(self) -> None:
        self.plain = bytearray()  # what was text in the last feeding, for an echo
        self._line = bytearray()
        self._after_cr = False
        self._command = bytearray()

    def feed(self, data: bytes) -> list[Event]:
        """The events that these bytes complete, in order."""
        events: list[Event] = []
        self.plain.clear()
        for byte in data:
            if self._command or byte == IAC:
                self._telnet(byte, events)
            else:
                self._text(byte, events)
        return events

    def _text(self, byte: int, events: list[Event]) -> None:
        after_cr, self._after_cr = self._after_cr, byte == CR
        if byte in CONTROLS:
            events.append(byte)
            return
        self.plain.append(byte)
        if byte in (CR, END_OF_FILE) or (byte == LF and not after_cr):
            events.append(self._line.decode("latin-1") + (chr(END_OF_FILE) if byte == END_OF_FILE else ""))
            self._line.clear()
        elif byte not in (0, LF) and len(self._line) < KEPT_BYTES:
            self._line.append(byte)

    def _telnet(self, byte: int, events: list[Event]) -> None:
        self._command.append(byte)
        told = self._command
        if len(told) == 1 or (len(told) == 2 and WILL <= byte <= DONT):
            return
        if told[1] == SUBNEGOTIATION:
            if told[-2:] != bytes((IAC, SUBNEGOTIATION_END)) and len(told) < LONGEST_SUBNEGOTIATION:
                return
        elif len(told) == 3:
            events.append(Negotiation(told[1], told[2]))
        elif byte == INTERRUPT:
            events.append(ETX)
        elif byte < SUBNEGOTIATION_END or byte == IAC:
            told.clear()
            self._text(byte, events)
        told.clear()
