"""`cellctl camera ...`"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cellctl.cli.options import FILE, F, end, option, with_cell_if_any, with_config, with_json

if TYPE_CHECKING:
    from cellctl.desk.camera_link import Exposure, Which

NUMBERS = click.Choice(["1", "2"])


@click.group()
def camera() -> None:
    """Find the cameras, look through them, check their network. What takes pictures needs the daemon stopped."""


def with_camera(command: F) -> F:
    """The argument that says which camera of the cell is meant."""
    return click.argument("number", type=NUMBERS, metavar="1|2")(with_config(command))


def with_exposure(command: F) -> F:
    """The options of the exposure."""
    command = option("--gain-db", type=click.FloatRange(0.0, 48.0), help="Gain; needs --exposure-us.")(command)
    text = "Exposure time.  [default: as the camera has it]"
    return option("--exposure-us", type=click.FloatRange(1.0, 10_000_000.0), help=text)(command)


def which_of(config: Path, number: str) -> "Which":
    """The camera that is meant."""
    from cellctl.desk.camera_link import Which

    return Which(config, int(number))


def exposure_of(exposure_us: float | None, gain_db: float | None) -> "Exposure":
    """The exposure that is asked for."""
    from cellctl.desk.camera_link import Exposure

    if gain_db is not None and exposure_us is None:
        raise click.UsageError("--gain-db needs --exposure-us: both are set together")
    return Exposure(exposure_us, gain_db)


@camera.command("list")
@option(
    "--within-s", type=click.FloatRange(0.1, 10.0), default=0.7, show_default=True, help="Wait so long for answers."
)
@with_cell_if_any
@with_json
def camera_list(config: Path | None, within_s: float, as_json: bool) -> None:
    """List all GigE Vision cameras that answer on any network of this computer, and the video devices.

    Ends with 1 when a camera of the cell does not answer.
    """
    from cellctl.desk.camera_list import list_cameras

    end(list_cameras(config, as_json=as_json, within_s=within_s))


@camera.command("info")
@with_camera
@with_json
def camera_info(config: Path, number: str, as_json: bool) -> None:
    """Show what camera 1 or 2 tells of itself; the daemon may be at work with it."""
    from cellctl.desk.camera_info import info

    end(info(which_of(config, number), as_json=as_json))


@camera.command("snap")
@with_camera
@option("--out", type=FILE, default=Path("snap.png"), show_default=True, help="File; with --count NAME-001.png ...")
@option("--count", "pictures", type=click.IntRange(1, 10_000), default=1, show_default=True, help="So many pictures.")
@option("--deep", is_flag=True, help="16 bit, with all that the pixel format has, instead of 8 bit as vision sees it.")
@option("--force", is_flag=True, help="Replace files that exist.")
@with_exposure
@with_json
def camera_snap(config: Path, number: str, exposure_us: float | None, gain_db: float | None, **options: Any) -> None:
    """Write pictures of camera 1 or 2 as PNG."""
    from cellctl.desk.camera_snap import Order, snap

    end(snap(Order(which_of(config, number), exposure_of(exposure_us, gain_db), **options)))


@camera.command("live")
@with_camera
@option("--port", type=click.IntRange(0, 65535), default=0, help="Port on this computer.  [default: a free one]")
@option("--terminal", is_flag=True, help="Draw into the terminal instead of serving a browser.")
@option("--per-s", type=click.FloatRange(0.1, 30.0), default=5.0, show_default=True, help="Pictures per second.")
@option("--longest-px", type=click.IntRange(64, 10_000), default=1300, show_default=True, help="Longer side shown.")
@option("--pictures", type=click.IntRange(0), default=0, help="End after so many.  [default: until Ctrl-C]")
@with_exposure
@with_json
def camera_live(config: Path, number: str, exposure_us: float | None, gain_db: float | None, **options: Any) -> None:
    """Look through camera 1 or 2: in a browser on this computer, or in the terminal.

    Below the picture: grey levels, share of white, and sharpness, which is largest in the best focus.
    """
    from cellctl.desk.camera_live import Order, live

    end(live(Order(which_of(config, number), exposure_of(exposure_us, gain_db), **options)))


@camera.command("set-address")
@click.argument("serial")
@click.argument("address")
@with_json
def camera_set_address(serial: str, address: str, as_json: bool) -> None:
    """Give the GigE camera SERIAL another ADDRESS until it is switched off, also when it is in a foreign network."""
    from cellctl.desk.camera_address import Order, set_address

    end(set_address(Order(serial, address, as_json)))


@camera.command("check")
@click.argument("numbers", nargs=-1, type=NUMBERS, metavar="[1|2]...")
@option("--pictures", type=click.IntRange(0, 10_000), default=20, show_default=True, help="Trial pictures of each.")
@with_config
@with_json
def camera_check(config: Path, numbers: tuple[str, ...], pictures: int, as_json: bool) -> None:
    """Check network card, kernel and cameras, and take trial pictures; says what to do about what is wrong.

    Ends with 1 when something is wrong that loses pictures.
    """
    from cellctl.desk.camera_check import Order, check_cameras

    end(check_cameras(Order(config, tuple(map(int, numbers)) or (1, 2), pictures, as_json)))
