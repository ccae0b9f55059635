"""`cellctl calibrate ...`"""

from pathlib import Path

import click

from cellctl.cli.options import end, job, with_config, with_json


@click.group()
def calibrate() -> None:
    """Find out where the cameras and the tool are, and how well that is known."""


def calibration(what: str, text: str) -> None:
    """Add one calibration to the command line."""

    @calibrate.command(what, help=text)
    @with_config
    @with_json
    def command(config: Path, as_json: bool) -> None:
        job(config, {"verb": "calibrate", "what": what}, as_json=as_json)


calibration("camera-1", "Calibrate the camera on the robot on its dot board.")
calibration("camera-2", "Calibrate the fixed camera with the dot plate.")
calibration("tool", "Find the centre of the tool.")


@calibrate.command("report")
@with_config
@with_json
def calibrate_report(config: Path, as_json: bool) -> None:
    """Show the calibrations in use and how good they are."""
    from cellctl.check import report

    end(report(config, as_json=as_json))
