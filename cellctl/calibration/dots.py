"""Find the dot board in a picture: every dot, to a few hundredths of a pixel, in board order."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.blobs import MOST_CANDIDATES, Candidates, Pixels, Spot, find_candidates, measure_spot
from cellctl.calibration.board import DotBoard
from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.lattice import Lattice, find_lattice

FloatArray = NDArray[np.float64]

LEAST_SIDE_PX = 64
DARKEST = 40.0  # level the brightest hundredth of the picture must exceed
LEAST_CONTRAST = 40.0  # levels between plate and dots
SATURATED = 253.0
NEAR_BORDER_PX = 16.0  # dots nearer to the border than this are not measured
LEAST_ORIGIN_RATIO = 0.75  # part of the drawn area ratio of the origin dot
WORST_RESIDUAL_PX = 0.75  # print error and distortion beyond k1; 5 um


@dataclass(frozen=True, eq=False)
class Dots:
    """A board that was found. `centres_px` is (count, 2) in board order."""

    centres_px: FloatArray
    residual_rms_px: float  # against a flat, evenly spaced board behind a lens with k1, per axis
    residual_worst_px: float
    worst_dot: tuple[int, int]  # column, row
    px_per_mm: float
    bright: float  # level of the plate, median
    contrast: float  # of the weakest dot


def find_dots(pixels: Pixels, board: DotBoard | None = None, *, mirrored: bool) -> Dots:
    """Find all dots of a board lying at any rotation.

    `pixels` is (height, width) uint8; `mirrored` says that the camera sees the plane mirrored (it looks down at it).
    Raises BoardNotFound with the check that failed and its figures, ValueError for an array that is no such picture.
    """
    board = board or DotBoard()
    _check_picture(pixels)
    found = find_candidates(pixels, board.count, (board.origin_dot_mm / board.dot_mm) ** 2)
    lattice = _lattice(pixels, found, board)
    order = _board_order(lattice, found, board, mirrored)
    spots = _measure(pixels, found, order, board)
    return _result(spots, board, pixels.shape[:2])


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


def _lattice(pixels: Pixels, found: Candidates, board: DotBoard) -> Lattice:
    """All dots of the board as a full lattice, or BoardNotFound saying what is missing."""
    count = len(found.areas_px)
    if count > MOST_CANDIDATES:
        raise BoardNotFound(
            "dots", f"{count} round spots in the picture, the board has {board.count}: is this the board?"
        )
    lattice = find_lattice(found.centres_px)
    if lattice is None or len(lattice.members) < 4:
        bright = float(np.mean(pixels[::8, ::8] >= SATURATED)) * 100
        raise BoardNotFound(
            "dots",
            f"{count} round dark spots, none of them in rows and columns, {board.count} are wanted"
            + (f"; {bright:.0f} % of the picture is saturated: expose for a shorter time" if bright > 20 else ""),
            wanted=board.count,
        )
    seen = len(lattice.members)
    full = sorted(lattice.size) == sorted((board.columns, board.rows))
    if seen == board.count and full:
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


def _board_order(lattice: Lattice, found: Candidates, board: DotBoard, mirrored: bool) -> NDArray[np.int64]:
    """Index of the candidate for every dot in board order; the larger corner dot says how the board lies."""
    places, areas = lattice.places, found.areas_px[lattice.members]
    size = np.array(lattice.size)
    corner = places[int(areas.argmax())]
    ratio = float(areas.max() / np.median(areas))
    wanted = (board.origin_dot_mm / board.dot_mm) ** 2
    at_corner = bool(np.all((corner == 0) | (corner == size - 1)))
    if not at_corner or ratio < LEAST_ORIGIN_RATIO * wanted:
        raise BoardNotFound(
            "origin dot",
            f"the largest dot is {ratio:.2f} times a usual one ({wanted:.2f} wanted) and "
            f"{'at' if at_corner else 'not at'} a corner: clean the board, or is it another board?",
            seen=len(areas),
            wanted=board.count,
        )
    from_corner = np.abs(places - corner)
    steps = lattice.steps_px * np.where(corner == 0, 1, -1)[:, None]
    square = board.columns == board.rows  # such a board may be read along either side: take the one as described
    if lattice.size[0] != board.columns or (square and _is_mirrored(steps) != mirrored):
        from_corner, steps = from_corner[:, ::-1], steps[::-1]
    if _is_mirrored(steps) != mirrored:
        seen, described = ("as it is", "mirrored") if mirrored else ("mirrored", "as it is")
        raise BoardNotFound(
            "mirrored",
            f"the board appears {seen}, but this camera is described as seeing things {described}: is the plate "
            "upside down, the picture flipped, or the wrong camera set?",
            seen=len(areas),
            wanted=board.count,
        )
    order = np.empty(board.count, dtype=np.int64)
    order[from_corner[:, 1] * board.columns + from_corner[:, 0]] = lattice.members
    return order


def _is_mirrored(steps_px: FloatArray) -> bool:
    return bool(np.linalg.det(steps_px) < 0)


def _measure(pixels: Pixels, found: Candidates, order: NDArray[np.int64], board: DotBoard) -> list[Spot]:
    """Every dot to sub-pixel, in board order."""
    usual = math.sqrt(float(np.median(found.areas_px[order])) / math.pi)
    spots: list[Spot] = []
    for place, index in enumerate(order.tolist()):
        radius = usual * (board.origin_dot_mm / board.dot_mm if place == 0 else 1.0)
        spot = measure_spot(pixels, found.centres_px[index], radius)
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
    """Residuals (n, 2) of an even board behind an affine map with k1 about the picture's centre, and px per mm."""
    away = centres - (np.array(shape[::-1]) - 1) / 2
    bent = away * (away**2).sum(1, keepdims=True) / max(shape) ** 2
    even = np.column_stack([points_mm, np.ones(len(points_mm))])
    nothing = np.zeros_like(even)
    design = np.concatenate([np.hstack([even, nothing, bent[:, :1]]), np.hstack([nothing, even, bent[:, 1:]])])
    right = centres.T.ravel()
    found = np.linalg.lstsq(design, right, rcond=None)[0]
    residuals = (right - design @ found).reshape(2, -1).T
    (a, b, _), (c, d, _) = found[:6].reshape(2, 3)
    return residuals, math.sqrt(abs(float(a * d - b * c)))
