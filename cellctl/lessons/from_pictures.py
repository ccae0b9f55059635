"""What a set of picture files teaches: the first picture is recognised, the others are measured like it.

Where the choice is not clear a person points; the candidates are then drawn with their numbers and written out as the
options that name them.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

from cellctl.lessons.values import CannotTeach
from cellctl.pictures.files import Picture, read_picture, write_picture
from cellctl.pictures.scale import Scale
from cellctl.vision.candidates import draw_candidates
from cellctl.vision.features import ExpectedCircle, ExpectedEdge, NotFound, Search
from cellctl.vision.lesson import BaseLesson, BatteryLesson, Pointed, first_base, first_battery, next_base, next_battery
from cellctl.vision.recognise import Undecided

NEAR_FIRST = Search(400.0, 4.0)  # the part lies within so much of where it lay in the first picture
T = TypeVar("T")


class Album(NamedTuple):
    """Pictures of one part, and what a person pointed at."""

    part: str
    paths: Sequence[Path]
    scale: Scale
    pointed: Pointed
    out: Path  # folder for drawings
    bits: int
    say: Callable[[str], None]  # what a person may read while it goes on


def base_lessons(album: Album) -> list[BaseLesson]:
    """One lesson per picture of the base. Raises CannotTeach with the picture and the check that failed."""
    first = _learnt(album, 0, lambda picture: first_base(picture.pixels, album.pointed))
    look = partial(next_base, expected=first.expected, search=NEAR_FIRST)
    return [first, *(_learnt(album, n, lambda picture: look(picture.pixels)) for n in range(1, len(album.paths)))]


def battery_lessons(album: Album) -> list[BatteryLesson]:
    """One lesson per picture of the battery. Raises CannotTeach with the picture and the check that failed."""
    first = _learnt(album, 0, lambda picture: first_battery(picture.pixels, album.pointed))
    look = partial(next_battery, expected=first.expected, skip_px=first.skip_px, search=NEAR_FIRST)
    return [first, *(_learnt(album, n, lambda picture: look(picture.pixels)) for n in range(1, len(album.paths)))]


def _learnt(album: Album, number: int, learn: Callable[[Picture], T]) -> T:
    """The lesson of one picture."""
    picture = read_picture(album.paths[number], album.bits)
    try:
        album.scale.check(picture.pixels)
        lesson = learn(picture)
    except Undecided as error:
        raise CannotTeach(_choice(album, picture, error)) from None
    except NotFound as error:
        if number:
            raise CannotTeach(f"{picture.path}: not as in {album.paths[0].name}: {error}") from None
        raise CannotTeach(f"{picture.path}: no {album.part} recognised: {error}; point at it: {_POINT}") from None
    album.say(f"{album.part} {number + 1}/{len(album.paths)} {picture.path.name}")
    return lesson


_POINT = "--hole U,V,R and --edge U1,V1,U2,V2 for a base, --battery-edge U1,V1,U2,V2 twice for a battery"


def _choice(album: Album, picture: Picture, error: Undecided) -> str:
    """The candidates in words and in a drawing."""
    drawing = album.out / f"candidates-{picture.path.stem}.jpg"
    write_picture(drawing, draw_candidates(picture.pixels, error.candidates, f"{picture.path.name}: {error}"))
    lines = [f"{picture.path}: {error}, see {drawing}; point at the right one (px of this picture, the first):"]
    lines += [f"  {n}: {_option(album.part, feature)}" for n, feature in enumerate(error.candidates, 1)]
    return "\n".join(lines)


def _option(part: str, feature: ExpectedCircle | ExpectedEdge) -> str:
    if isinstance(feature, ExpectedCircle):
        return f"--hole {feature.centre.u:.0f},{feature.centre.v:.0f},{feature.radius_px:.0f}"
    name = "--edge" if part == "base" else "--battery-edge"
    return f"{name} {feature.start.u:.0f},{feature.start.v:.0f},{feature.end.u:.0f},{feature.end.v:.0f}"
