"""What the simulators' programs share: an exact loop, and running until somebody stops them."""

import argparse
import asyncio
import selectors
import signal


def exact_loop() -> asyncio.AbstractEventLoop:
    """A loop whose timers are not rounded to milliseconds, which are tenths of a second of a fast world."""
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


async def until_stopped() -> None:
    """Return at SIGINT or SIGTERM."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    await stop.wait()


def host_port(text: str) -> tuple[str, int]:
    """`127.0.0.1:10023` as host and port, for an argument of a program."""
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT")
    return host, int(port)
