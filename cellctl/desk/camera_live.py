"""`cellctl camera live`: look through a camera of the cell, in a browser on this computer or in the terminal."""

import asyncio
import json
import shutil
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any, NamedTuple

import click

from cellctl.desk.camera_link import Exposure, Which, at_desk
from cellctl.desk.commands import run_loop
from cellctl.desk.live_http import LiveServer
from cellctl.desk.live_terminal import drawn
from cellctl.desk.live_view import LiveView, caption_of, jpeg_of, smaller
from drivers.camera import Camera, Frame
from drivers.camera_reopening import keep_open
from drivers.errors import DeviceError

AFTER_A_FAILURE_S = 0.5

Show = Callable[[Frame], Coroutine[Any, Any, None]]


class Order(NamedTuple):
    """What the command line asks for. `pictures` 0: until Ctrl-C."""

    which: Which
    exposure: Exposure
    port: int
    terminal: bool
    per_s: float
    longest_px: int
    pictures: int
    as_json: bool


def live(order: Order) -> int:
    """Show pictures until Ctrl-C, or so many. Raises SettingsError, DeviceError, ClickException."""
    return run_loop(_live(order))


async def _live(order: Order) -> int:
    async with AsyncExitStack() as stack:
        camera = await stack.enter_async_context(at_desk(order.which, order.exposure))
        show = _in_terminal if order.terminal else await _in_browser(order, stack)
        await stack.enter_async_context(_kept_open(camera))
        await _show_pictures(camera, order, show)
    return 0


@asynccontextmanager
async def _kept_open(camera: Camera) -> AsyncIterator[None]:
    keeping = asyncio.create_task(keep_open(camera))
    try:
        yield
    finally:
        keeping.cancel()
        await asyncio.wait([keeping])


async def _in_browser(order: Order, stack: AsyncExitStack) -> Show:
    """Serve the pictures until the stack is left."""
    view = LiveView()
    try:
        server = await stack.enter_async_context(LiveServer(view, order.which.name, order.port))
    except OSError as error:
        raise click.ClickException(f"port {order.port}: {error.strerror}; take another one (--port)") from error
    click.echo(json.dumps({"url": server.url}) if order.as_json else f"{order.which.name} live: {server.url}")

    def prepared(frame: Frame) -> bytes:
        return jpeg_of(smaller(frame.pixels, order.longest_px), caption_of(frame))

    async def show(frame: Frame) -> None:
        view.show(await asyncio.to_thread(prepared, frame))

    return show


async def _in_terminal(frame: Frame) -> None:
    columns, lines = shutil.get_terminal_size()
    caption = await asyncio.to_thread(caption_of, frame)
    click.echo(drawn(frame.pixels, columns, lines, caption), nl=False, color=True)


async def _show_pictures(camera: Camera, order: Order, show: Show) -> None:
    """A camera that is lost is opened again meanwhile. The same trouble is told once."""
    loop, shown, told = asyncio.get_running_loop(), 0, ""
    while not order.pictures or shown < order.pictures:
        due_s = loop.time() + 1 / order.per_s
        try:
            await show(await camera.grab())
            shown, told = shown + 1, ""
        except DeviceError as error:
            if str(error) != told:
                click.echo(f"{error}", err=True)
            told = str(error)
            await asyncio.sleep(AFTER_A_FAILURE_S)
        await asyncio.sleep(max(0.0, due_s - loop.time()))
