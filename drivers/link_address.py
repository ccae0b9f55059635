"""Addresses of controllers on a line. Pure.

tcp://HOST:PORT              serial:/dev/ttyS0?baud=9600&parity=odd&flow=xonxoff, or without `serial:`
"""

from typing import NamedTuple
from urllib.parse import parse_qsl, urlsplit

BAUDS = (4800, 9600, 19200, 38400, 57600, 115200)
PARITIES = ("none", "odd", "even")
FLOWS = ("none", "xonxoff", "rtscts")


class TcpAddress(NamedTuple):
    """Where a controller listens."""

    host: str
    port: int


class SerialAddress(NamedTuple):
    """A serial port and its settings; 8 data bits, 1 stop bit."""

    path: str
    baud: int
    parity: str
    flow: str


def parse_address(text: str) -> TcpAddress | SerialAddress:
    """Read a link address; raises ValueError with the value and the remedy."""
    if text.startswith("tcp://"):
        return _tcp_address(text)
    if text.startswith(("serial:", "/")):
        return _serial_address(text)
    raise ValueError(f"{text!r} is no link address: write tcp://HOST:PORT or serial:/dev/ttyS0?baud=9600")


def _tcp_address(text: str) -> TcpAddress:
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port or any((parts.path, parts.query, parts.fragment, parts.username)):
        raise ValueError(f"{text!r} needs a host and a port from 1 to 65535: write tcp://192.168.0.2:23")
    return TcpAddress(host, port)


def _serial_address(text: str) -> SerialAddress:
    path, _, query = text.removeprefix("serial:").partition("?")
    if not path.startswith("/"):
        raise ValueError(f"{text!r} needs the whole path of a port: write serial:/dev/ttyS0?baud=9600")
    given = {"baud": "9600", "parity": "odd", "flow": "xonxoff"}
    for key, value in parse_qsl(query, keep_blank_values=True):
        if key not in given:
            raise ValueError(f"{text!r} has the unknown setting {key!r}: there are baud, parity, flow")
        given[key] = value
    choices = {"baud": tuple(map(str, BAUDS)), "parity": PARITIES, "flow": FLOWS}
    for key, allowed in choices.items():
        if given[key] not in allowed:
            raise ValueError(f"{text!r}: {key} is {given[key]!r}, choose one of {', '.join(allowed)}")
    return SerialAddress(path, int(given["baud"]), given["parity"], given["flow"])
