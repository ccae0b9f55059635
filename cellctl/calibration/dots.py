"""Find the dot board in a picture: every dot, to a few hundredths of a pixel, in board order."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.blobs import Candidates, Pixels, Spot, find_candidates, measure_spot
from cellctl.calibration.board import DotBoard
from cellctl.calibration.dot_order import board_order
from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.homography import homography, local_steps
from cellctl.calibration.lattice import Lattice, find_lattice

FloatArray = NDArray[np.float64]

LEAST_SIDE_PX = 64
DARKEST = 40.0  # level the brightest hundredth of the picture must exceed
LEAST_CONTRAST = 40.0  # levels between plate and dots
SATURATED = 253.0
NEAR_BORDER_PX = 16.0  # dots nearer to the border than this are not measured
HALVINGS = (2, 1, 0)  # of the picture in which dots are looked for, the fastest first
MOST_SPOTS = 10  # per dot of the board
LEAST_LATTICE = 0.2  # part of the dots that must be in rows and columns, or it is another thing
LEAST_SEEN = 0.6  # part of the dots: it is the board, and a larger picture shows no more when its dots are
LARGE_PX2 = 80.0  # as large as this
WORST_RESIDUAL_PX = 0.75  # print error and distortion beyond k1; 5 um


@dataclass(frozen=True, eq=False)
class Dots:
    """A board that was found. `centres_px` is (count, 2) in board order."""

    centres_px: FloatArray
    residual_rms_px: float  # against a flat, evenly spaced board seen askew through a lens with k1, per axis
    residual_worst_px: float
    worst_dot: tuple[int, int]  # column, row
    px_per_mm: float
    bright: float  # level of the plate, median
    contrast: float  # of the weakest dot


def find_dots(pixels: Pixels, board: DotBoard | None = None, *, mirrored: bool | None) -> Dots:
    """Find all dots of a board lying at any rotation, and tilted by up to some 45 degrees.

    `pixels` is (height, width) uint8; `mirrored` says that the camera sees the plane mirrored (it looks down at it),
    None that either will do. Raises BoardNotFound with the check that failed and its figures, ValueError for an array
    that is no such picture.
    """
    board = board or DotBoard()
    _check_picture(pixels)
    found, lattice = _candidates(pixels, board)
    lattice = _whole(pixels, found, lattice, board)
    order, usual = board_order(lattice, found.areas_px, board, mirrored)
    spots = _measure(pixels, found, order, usual, board)
    return _result(spots, board, pixels.shape[:2])


def _candidates(pixels: Pixels, board: DotBoard) -> tuple[Candidates, Lattice | None]:
    """Spots and the lattice in them, in the smallest picture that shows the dots."""
    largest = (board.origin_dot_mm / board.dot_mm) ** 2
    best: tuple[Candidates, Lattice | None] | None = None
    for halvings in HALVINGS:
        found = find_candidates(pixels, board.count, largest, halvings)
        lattice = find_lattice(found.centres_px) if len(found.areas_px) <= MOST_SPOTS * board.count else None
        if best is None or _members(lattice) > _members(best[1]):
            best = found, lattice
        large = len(found.areas_px) > 0 and float(np.median(found.areas_px)) >= LARGE_PX2 * 4**halvings
        if _members(lattice) == board.count or (large and _members(lattice) > LEAST_SEEN * board.count):
            break
    assert best is not None
    return best


def _members(lattice: Lattice | None) -> int:
    return 0 if lattice is None else len(lattice.members)


def _check_picture(pixels: Pixels) -> None:
    if pixels.ndim != 2 or pixels.dtype != np.uint8 or min(pixels.shape) < LEAST_SIDE_PX:
        raise ValueError(
            f"dot board: the picture must be (height, width) uint8, at least {LEAST_SIDE_PX} px on each side "
            f"(got {pixels.dtype} {pixels.shape})"
        )
    low, high = np.percentile(pixels[::8, ::8], [1, 99])
    if high < DARKEST:
        raise BoardNotFound(
            "too dark",
            f"the brightest hundredth of the picture is at {high:.0f} of 255: switch the light on or expose longer",
        )
    if low >= SATURATED:
        raise BoardNotFound(
            "saturated", f"99 % of the picture is at {low:.0f} of 255 or above: expose for a shorter time"
        )
    if high - low < LEAST_CONTRAST / 2:
        raise BoardNotFound(
            "contrast",
            f"the picture spans {high - low:.0f} grey levels only: is the board under the camera and in focus?",
        )


def _whole(pixels: Pixels, found: Candidates, lattice: Lattice | None, board: DotBoard) -> Lattice:
    """All dots of the board as a full lattice, or BoardNotFound saying what is missing."""
    count = len(found.areas_px)
    if count > MOST_SPOTS * board.count:
        raise BoardNotFound(
            "dots", f"{count} round spots in the picture, the board has {board.count}: is this the board?"
        )
    if lattice is None or len(lattice.members) < LEAST_LATTICE * board.count:
        bright = float(np.mean(pixels[::8, ::8] >= SATURATED)) * 100
        raise BoardNotFound(
            "dots",
            f"{count} round dark spots, {_members(lattice)} of them in rows and columns, {board.count} are wanted"
            + (f"; {bright:.0f} % of the picture is saturated: expose for a shorter time" if bright > 20 else ""),
            wanted=board.count,
        )
    full = sorted(lattice.size) == sorted((board.columns, board.rows))
    if len(lattice.members) == board.count and full:
        return lattice
    raise _incomplete(pixels, found, lattice, board)


def _incomplete(pixels: Pixels, found: Candidates, lattice: Lattice, board: DotBoard) -> BoardNotFound:
    seen = len(lattice.members)
    counted = f"{seen} of {board.count} dots seen ({lattice.size[0]} x {lattice.size[1]} places)"
    sides = _sides_left(pixels, found, lattice, board)
    if seen < board.count and sides:
        detail = f"{counted}; the board leaves the picture at the {' and the '.join(sides)}: bring it back into view"
        return BoardNotFound("in view", detail, seen=seen, wanted=board.count, sides=sides)
    if seen < board.count:
        detail = f"{counted}, none near the picture's border: clean the board, uncover it, look at glare and focus"
    else:
        detail = f"{counted}: is this the board that is described ({board.columns} x {board.rows})?"
    return BoardNotFound("dot count", detail, seen=seen, wanted=board.count)


def _sides_left(pixels: Pixels, found: Candidates, lattice: Lattice, board: DotBoard) -> tuple[str, ...]:
    """Sides of the picture beyond which missing dots would lie."""
    design = np.column_stack([lattice.places, np.ones(len(lattice.places))])
    to_px = np.linalg.lstsq(design, found.centres_px[lattice.members], rcond=None)[0]
    missing = _missing_places(lattice, board)
    u, v = (np.column_stack([missing, np.ones(len(missing))]) @ to_px).T
    edge = math.sqrt(float(np.median(found.areas_px)) / math.pi) + NEAR_BORDER_PX
    height, width = pixels.shape
    beyond = {"left": u < edge, "right": u > width - 1 - edge, "top": v < edge, "bottom": v > height - 1 - edge}
    return tuple(side for side, dots in beyond.items() if dots.any())


def _missing_places(lattice: Lattice, board: DotBoard) -> NDArray[np.int64]:
    """Places without a dot, (n, 2): inside the lattice, and one row further where it is shorter than the board."""
    longest, shortest = max(board.columns, board.rows), min(board.columns, board.rows)
    more = [
        int(size < longest and not (size >= shortest and other >= longest))
        for size, other in (lattice.size, lattice.size[::-1])
    ]
    ranges = [range(-extra, size + extra) for extra, size in zip(more, lattice.size, strict=True)]
    taken = {tuple(place) for place in lattice.places.tolist()}
    missing = [place for place in itertools.product(*ranges) if place not in taken]
    return np.array(missing, dtype=np.int64).reshape(-1, 2)


def _measure(
    pixels: Pixels, found: Candidates, order: NDArray[np.int64], usual: FloatArray, board: DotBoard
) -> list[Spot]:
    """Every dot to sub-pixel, in board order; `usual` (count,) is the area that a usual dot has at each place."""
    places = board.points_mm / board.pitch_mm
    steps = local_steps(homography(places, found.centres_px[order]), places)
    radii = np.sqrt(usual / (math.pi * np.abs(np.linalg.det(steps))))
    radii[0] *= board.origin_dot_mm / board.dot_mm
    spots: list[Spot] = []
    for place, index in enumerate(order.tolist()):
        spot = measure_spot(pixels, found.centres_px[index], steps[place] * radii[place])
        if spot is None:
            name = f"({place % board.columns}, {place // board.columns})"
            raise BoardNotFound(
                "in view",
                f"dot {name} touches the picture's border: move the board further in",
                seen=board.count,
                wanted=board.count,
            )
        spots.append(spot)
    return spots


def _result(spots: list[Spot], board: DotBoard, shape: tuple[int, ...]) -> Dots:
    table = np.array(spots)
    contrast, bright = float((table[:, 3] - table[:, 4]).min()), float(np.median(table[:, 3]))
    if bright >= SATURATED:
        raise BoardNotFound(
            "saturated",
            f"the plate between the dots is at {bright:.0f} of 255: expose for a shorter time",
            seen=len(spots),
            wanted=board.count,
        )
    if contrast < LEAST_CONTRAST:
        raise BoardNotFound(
            "contrast",
            f"the weakest dot differs from the plate by {contrast:.0f} levels, {LEAST_CONTRAST:.0f} are needed: expose "
            "longer, clean the board",
            seen=len(spots),
            wanted=board.count,
        )
    away, px_per_mm = _flatness(table[:, :2], board.points_mm, shape)
    worst = int(np.hypot(*away.T).argmax())
    dots = Dots(
        centres_px=table[:, :2],
        residual_rms_px=math.sqrt(float((away**2).mean())),
        residual_worst_px=float(np.hypot(*away[worst])),
        worst_dot=(worst % board.columns, worst // board.columns),
        px_per_mm=px_per_mm,
        bright=bright,
        contrast=contrast,
    )
    if dots.residual_worst_px > WORST_RESIDUAL_PX:
        raise BoardNotFound(
            "flatness",
            f"dot {dots.worst_dot} is {dots.residual_worst_px:.2f} px from its place among the others "
            f"({WORST_RESIDUAL_PX:g} px allowed): clean the board",
            seen=len(spots),
            wanted=board.count,
        )
    return dots


def _flatness(centres: FloatArray, points_mm: FloatArray, shape: tuple[int, ...]) -> tuple[FloatArray, float]:
    """Residuals (n, 2) of an even board seen in perspective with k1 about the picture's centre, and px per mm.

    Linear in all unknowns: px (1 + g mm) = A mm + b + k1 bent (1 + g mm), the last factor taken as 1.
    """
    away = centres - (np.array(shape[::-1]) - 1) / 2
    bent = away * (away**2).sum(1, keepdims=True) / max(shape) ** 2
    board = points_mm - points_mm.mean(0)
    even, nothing = np.column_stack([board, np.ones(len(board))]), np.zeros((len(board), 3))
    rows_u = np.hstack([even, nothing, bent[:, :1], -board * away[:, :1]])
    rows_v = np.hstack([nothing, even, bent[:, 1:], -board * away[:, 1:]])
    design, right = np.concatenate([rows_u, rows_v]), away.T.ravel()
    found = np.linalg.lstsq(design, right, rcond=None)[0]
    residuals = (right - design @ found).reshape(2, -1).T / (1 + board @ found[7:])[:, None]
    (a, b, _), (c, d, _) = found[:6].reshape(2, 3)
    return residuals, math.sqrt(abs(float(a * d - b * c)))
