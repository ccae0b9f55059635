"""`cellctl calibrate lens`: the lens behind a folder of pictures of a board."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import click
import cv2

from cellctl.calibration.errors import BoardNotFound, CalibrationError, LensRefused
from cellctl.calibration.lens.boards import Board, board_text
from cellctl.calibration.lens.outliers import PictureOut
from cellctl.calibration.lens.report import lens_text
from cellctl.calibration.lens.report_picture import lens_picture
from cellctl.calibration.lens.sightings import Pixels, Sighting, find_board, seen_instead, views_of
from cellctl.calibration.lens.solve import LensResult, calibrate_lens
from cellctl.calibration.plane_map import Lens
from cellctl.desk.commands import OK
from cellctl.desk.lens_file import LensFile
from cellctl.learnt.references import write_whole
from cellctl.pictures.files import Picture, PictureError, picture_paths, read_picture

REFUSED = 1
REPORT = "report.png"
MOST_PICTURES = 500
MOST_LOOKED_AT = 6  # pictures without the board that are searched for another one
Say = Callable[[str], None]


class LensOrder(NamedTuple):
    """What the command line asks for."""

    folder: Path
    board: Board
    board_as_written: str
    lens: Lens
    out: Path | None
    as_json: bool

    @property
    def out_folder(self) -> Path:
        """Where the results go."""
        return self.out or Path(f"lens-{self.folder.resolve().name}")


class Found(NamedTuple):
    """What was found in all pictures of one size."""

    names: list[str]
    sightings: list[Sighting]
    out: list[PictureOut]
    without: list[Pixels]  # some of the pictures without the board
    picture_px: tuple[int, int]


def calibrate_folder(order: LensOrder) -> int:
    """Find the board, calibrate, report, write; 1 with a sentence when the lens is refused. Raises PictureError."""
    if order.out_folder.resolve() == order.folder.resolve():
        raise PictureError(f"{order.out_folder}: the results must not go among the pictures (--out)")
    paths = picture_paths([order.folder])
    if len(paths) > MOST_PICTURES:
        raise PictureError(f"{order.folder}: {len(paths)} pictures; more than {MOST_PICTURES} are not used")
    out: list[PictureOut] = []
    try:
        result = _calibrated(order, paths, out)
    except CalibrationError as error:
        return _refused(order, error, out)
    file = LensFile.of(result, order.board_as_written)
    written = _written(order.out_folder, file, result)
    if order.as_json:
        click.echo(json.dumps({"ok": True, "files": written, "result": file.model_dump(mode="json")}))
    else:
        click.echo(f"{lens_text(result)}\n\nwritten: {', '.join(written)}")
    return OK


def _calibrated(order: LensOrder, paths: list[Path], out: list[PictureOut]) -> LensResult:
    """The result; `out` gets every picture that is left out, also when the lens is refused."""
    found = _search(paths, order.board, _progress)
    out += found.out
    if not found.names:
        raise LensRefused("board", _nothing_found(found, order.board, len(paths)))
    views = views_of(found.sightings, order.board, found.picture_px)
    result = calibrate_lens(order.lens, views, found.names, _progress)
    return replace(result, out=(*found.out, *result.out))


def _progress(text: str) -> None:
    click.echo(text, err=True)


def _search(paths: list[Path], board: Board, say: Say) -> Found:
    """The board in every picture of the most frequent size."""
    say(f"reading {len(paths)} pictures")
    sizes = Counter(_size(picture) for picture in map(_read, paths) if isinstance(picture, Picture))
    usual = sizes.most_common(1)[0][0] if sizes else (0, 0)
    found = Found([], [], [], [], usual)
    for number, path in enumerate(paths, 1):
        text = _look(path, board, found)
        say(f"[{number:>{len(str(len(paths)))}}/{len(paths)}] {path.name}: {text}")
    return found


def _look(path: Path, board: Board, found: Found) -> str:
    """Search one picture and put what was found where it belongs; in words."""
    picture = _read(path)
    reason = _unusable(picture, found.picture_px)
    if reason is None and isinstance(picture, Picture):
        try:
            sighting = find_board(picture.pixels, board)
            found.names.append(path.name)
            found.sightings.append(sighting)
            return f"{int(sighting.seen.sum())} points"
        except BoardNotFound as error:
            reason = str(error)
            if len(found.without) < MOST_LOOKED_AT:
                found.without.append(picture.pixels)
    found.out.append(PictureOut(path.name, reason or ""))
    return f"left out: {reason}"


def _read(path: Path) -> Picture | PictureError:
    try:
        return read_picture(path)
    except PictureError as error:
        return error


def _size(picture: Picture) -> tuple[int, int]:
    height, width = picture.pixels.shape
    return width, height


def _unusable(picture: Picture | PictureError, usual: tuple[int, int]) -> str | None:
    """Why a picture cannot be searched, None when it can."""
    if isinstance(picture, PictureError):
        return str(picture).split(": ", 1)[-1]  # its name comes first
    width, height = _size(picture)
    if (width, height) != usual:
        return f"is {width} x {height} px, the others are {usual[0]} x {usual[1]}: one lens, one size"
    return None


def _nothing_found(found: Found, board: Board, count: int) -> str:
    """What was looked for, and what was seen."""
    width, height = found.picture_px
    sought = f"{board_text(board)} is in none of {count} pictures ({width} x {height} px)"
    other = seen_instead(found.without, board)
    if other:
        return f"{sought}; there is {other}: is the board described as it is (--board)?"
    reasons = Counter(out.reason for out in found.out)
    return f"{sought}; most often: {reasons.most_common(1)[0][0]}"


def _refused(order: LensOrder, error: CalibrationError, out: list[PictureOut]) -> int:
    if order.as_json:
        left_out = [{"name": one.name, "reason": one.reason} for one in out]
        click.echo(json.dumps({"ok": False, "check": error.check, "error": error.detail, "left_out": left_out}))
    else:
        for one in out:
            click.echo(f"{one.name}: left out: {one.reason}", err=True)
        click.echo(f"not calibrated: {error}", err=True)
    return REFUSED


def _written(folder: Path, file: LensFile, result: LensResult) -> list[str]:
    """Write the result and its report; the files' names. Raises PictureError."""
    _, encoded = cv2.imencode(".png", lens_picture(result))
    try:
        path = file.keep_in(folder)
        write_whole(folder / REPORT, encoded.tobytes())
    except OSError as error:
        raise PictureError(f"{folder}: cannot be written to: {error.strerror}") from error
    return [str(path), str(folder / REPORT)]
