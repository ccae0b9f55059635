"""`cellctl calibrate ...`"""

from pathlib import Path
from typing import Any

import click

from cellctl.cli.options import FILE, ask, end, job, option, with_config, with_json

CAMERA = click.argument("camera", type=click.Choice(["camera-1", "camera-2"]))


@click.group()
def calibrate() -> None:
    """Find out where the cameras and the tool are, and how well that is known."""


# -- jobs of the daemon ------------------------------------------------------------------------------------


def calibration(what: str, text: str) -> None:
    """Add one calibration to the command line."""

    @calibrate.command(what, help=text)
    @with_config
    @with_json
    def command(config: Path, as_json: bool) -> None:
        job(config, {"verb": "calibrate", "what": what}, as_json=as_json)


calibration("camera-1", "Calibrate the camera on the robot on its dot board.")
calibration("camera-2", "Calibrate the fixed camera with the dot plate.")
calibration("tool", "Measure the tool's rotation centre and the run-out of what it holds.")


@calibrate.command("verify")
@CAMERA
@with_config
@with_json
def calibrate_verify(camera: str, config: Path, as_json: bool) -> None:
    """Find out with a few poses whether a calibration still holds, after a collision for instance."""
    job(config, {"verb": "verify", "camera": camera}, as_json=as_json)


@calibrate.command("hysteresis")
@option("--repeats", type=click.IntRange(2, 50), default=4, show_default=True, help="Stops from each of eight sides.")
@with_config
@with_json
def calibrate_hysteresis(repeats: int, config: Path, as_json: bool) -> None:
    """Approach one stop from eight sides and show how the stops differ."""
    job(config, {"verb": "hysteresis", "repeats": repeats}, as_json=as_json)


# -- pictures of any camera --------------------------------------------------------------------------------


@calibrate.command("lens")
@click.argument("folder", type=FILE)
@option(
    "--board", required=True, help="chessboard:9x6:25mm, dots:9x7:1.2mm:0.6mm:0.9mm or charuco:8x6:20mm:15mm:4x4_50"
)
@option(
    "--model",
    type=click.Choice(["pinhole", "telecentric"]),
    default="pinhole",
    show_default=True,
    help="An ordinary lens, or one with parallel projection.",
)
@option("--out", type=FILE, help="Folder for lens.json and report.png instead of ./lens-NAME.")
@with_json
def calibrate_lens(folder: Path, board: str, model: str, out: Path | None, as_json: bool) -> None:
    """Calibrate a lens from a FOLDER of pictures of a flat board, tilted and near all corners.

    A board is named by its inner corners (chessboard), dots or squares (charuco) along x and y; then follow the side
    of a square, or pitch and diameters of the dots, or the sides of square and marker and the dictionary.
    """
    from cellctl.calibration.lens.boards import parse_board
    from cellctl.desk.lens import LensOrder, calibrate_folder

    try:
        described = parse_board(board)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--board") from None
    end(calibrate_folder(LensOrder(folder, described, board, model, out, as_json)))  # type: ignore[arg-type]


@calibrate.command("hand-eye")
@click.argument("files", nargs=-1, required=True, type=FILE)
@option(
    "--mount",
    type=click.Choice(["eye-in-hand", "eye-to-hand"]),
    default="eye-in-hand",
    show_default=True,
    help="The camera is on the tool and the target fixed, or the other way round.",
)
@option("--robot-ahead-ms", type=float, help="Two files: by how much the robot's clock is ahead. Default: found out.")
@option("--along-axis-mm", type=float, help="The camera's place along a single axis of rotation, measured by hand.")
@option("--plan", is_flag=True, help="Robot poses only, before it moves: can they tell where the camera is?")
@option("--compare", is_flag=True, help="Show the errors of OpenCV's five methods beside ours.")
@option("--out", type=FILE, help="JSON file to write.")
@with_json
def calibrate_hand_eye(files: tuple[Path, ...], mount: str, **options: Any) -> None:
    """Find a camera on, or beside, a robot that turns in space, from poses in one or two CSV FILES.

    One file: every row has the robot's pose and what the camera saw at that moment. Two files: the robot's stream and
    the camera's, each with time_s; they are brought to one time.

    The first row names the columns: time_s, robot_from_tool.PART (or tool_from_robot.PART) and camera_from_target.PART
    (or target_from_camera.PART). Parts are x_mm y_mm z_mm (or x_m y_m z_m) and one of: qx qy qz qw; rx_deg ry_deg
    rz_deg (a rotation vector; also _rad); roll_deg pitch_deg yaw_deg (about fixed x, then y, then z); r_deg (about z,
    a SCARA). Rows that begin with # are comments.
    """
    from cellctl.desk.hand_eye import HandEyeOrder, calibrate_poses

    if len(files) > (1 if options["plan"] else 2):
        raise click.UsageError("give one file with both poses, or one of the robot's and one of the camera's")
    as_json = options.pop("as_json")
    end(calibrate_poses(HandEyeOrder(files, mount.replace("-", "_"), as_json=as_json, **options)))  # type: ignore[arg-type]


# -- versions ----------------------------------------------------------------------------------------------


@calibrate.command("list")
@with_config
@with_json
def calibrate_list(config: Path, as_json: bool) -> None:
    """List all versions of both cameras: in use, kept, waiting to be accepted, refused."""
    from cellctl.desk.shelf import list_versions

    end(list_versions(config, as_json=as_json))


@calibrate.command("show")
@CAMERA
@click.argument("version", required=False)
@with_config
@with_json
def calibrate_show(camera: str, version: str | None, config: Path, as_json: bool) -> None:
    """Show one version (default: the one in use), and where it differs from the one in use."""
    from cellctl.desk.shelf import show_version

    end(show_version(config, camera, version, as_json=as_json))  # type: ignore[arg-type]


@calibrate.command("accept")
@CAMERA
@click.argument("version", required=False)
@with_config
@with_json
def calibrate_accept(camera: str, version: str | None, config: Path, as_json: bool) -> None:
    """Use a version (default: the newest that waits) from the next start on; then teach anew."""
    _use(config, camera, "accept", version, as_json=as_json)


@calibrate.command("revert")
@CAMERA
@with_config
@with_json
def calibrate_revert(camera: str, config: Path, as_json: bool) -> None:
    """Go back to the accepted version before the one in use."""
    _use(config, camera, "revert", None, as_json=as_json)


def _use(config: Path, camera: str, what: str, version: str | None, *, as_json: bool) -> None:
    request: dict[str, object] = {"verb": "calibration_use", "camera": camera, "what": what, "calibration": version}
    ask(config, request, as_json=as_json)


@calibrate.command("report")
@with_config
@with_json
def calibrate_report(config: Path, as_json: bool) -> None:
    """Show the calibrations in use and how good they are."""
    from cellctl.desk.shelf import report

    end(report(config, as_json=as_json))


@calibrate.command("temperature")
@click.argument("celsius", type=click.FloatRange(-20, 60))
@with_config
@with_json
def calibrate_temperature(celsius: float, config: Path, as_json: bool) -> None:
    """Enter the temperature at the robot; calibrations are used near the one they were made at."""
    ask(config, {"verb": "temperature", "celsius": celsius}, as_json=as_json)
