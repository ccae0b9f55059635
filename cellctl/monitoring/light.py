"""Whether the pictures of a camera stay as good as when the cell was taught: focus, light, exposure, noise. Pure.

The limit comes from the Cramer-Rao bound of an edge of contrast A, blur s and pixel noise n: the variance of its place
is 2 sqrt(pi) s n^2 / A^2 per pixel of its length, so the noise of every measured place grows with sqrt(s) n / A. A
warning is due when it has grown by a quarter: by defocus alone that is when the blur is 1.56 times as large, by failing
light alone when a fifth of it is gone. Pictures are a small part of the error of a placement, so nothing has suffered
by then; and the finders refuse much later, at the recipe's least contrast.

Every feature is followed by itself, by a mean that forgets and that a single odd picture moves little. What it is
compared with is the recipe's [light], or the median of the first pictures after teaching.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from cellctl.vision.features import Appearance

FIRST_PICTURES = 15  # are the measure of all later ones
FORGETS = 0.25  # weight of the newest picture in the mean
CLIP = 4.0  # a picture further off than so many typical steps counts as so many
LEAST_STEPS = Appearance(blur_px=0.02, contrast=1.0, noise=0.1, dark=1.0, bright=1.0, saturated=0.001)
MOST_GROWTH = 1.25  # of the noise of measured places
QUIET_AGAIN = 0.5  # a warning ends when this part of the way to its limit is left
NEAR_REFUSAL = 1.2  # contrast over the least contrast at which pictures are refused
BRIGHTEST = 245.0  # grey level of the bright side: above it the sensor saturates
MOST_SATURATED = 0.005  # share of an outline
PIXEL_VARIANCE = 1.0 / 12.0
DECIMALS = 4  # every unit's record keeps the trends


class Cause(StrEnum):
    """What a person has to look at."""

    FOCUS = "focus"
    LIGHT = "light"
    EXPOSURE = "exposure"
    NOISE = "noise"


@dataclass(frozen=True)
class Trend:
    """One feature since teaching: how many pictures, how it should look, how it looks now, its typical step."""

    pictures: int = 0
    first: tuple[Appearance, ...] = ()  # kept until there are enough
    taught: Appearance | None = None
    now: Appearance | None = None
    step: Appearance = LEAST_STEPS


class Warn(NamedTuple):
    """A cause and its sentence; `severity` is 1 at the limit."""

    cause: Cause
    severity: float
    sentence: str


def after(trend: Trend, seen: Appearance) -> Trend:
    """The trend with one more picture."""
    pictures, first, taught = trend.pictures + 1, trend.first, trend.taught
    if taught is None:
        first = (*first, seen)
        if len(first) == FIRST_PICTURES:
            first, taught = (), Appearance(*(statistics.median(values) for values in zip(*first, strict=True)))
    if trend.now is None:
        return Trend(pictures, first, taught, seen)
    now, step = [], []
    for x, mean, size, least in zip(seen, trend.now, trend.step, LEAST_STEPS, strict=True):
        off, limit = x - mean, CLIP * max(size, least)
        now.append(round(mean + FORGETS * min(max(off, -limit), limit), DECIMALS))
        step.append(round(size + FORGETS * (abs(off) - size), DECIMALS))
    return Trend(pictures, first, taught, Appearance(*now), Appearance(*step))


class Growth(NamedTuple):
    """By what blur, light and noise each multiply the noise of measured places."""

    blur: float
    light: float
    noise: float

    @property
    def total(self) -> float:
        """By what it has grown in all."""
        return self.blur * self.light * self.noise


def growth(taught: Appearance, now: Appearance) -> Growth:
    """The Cramer-Rao bound of a place now against when it was taught."""
    wide = math.hypot(now.blur_px, math.sqrt(PIXEL_VARIANCE)) / math.hypot(taught.blur_px, math.sqrt(PIXEL_VARIANCE))
    noise = max(now.noise, LEAST_STEPS.noise) / max(taught.noise, LEAST_STEPS.noise)
    return Growth(math.sqrt(wide), taught.contrast / max(now.contrast, LEAST_STEPS.contrast), noise)


def warnings(trend: Trend, least_contrast: float) -> list[Warn]:
    """All that a person may have to look at, of any severity; pictures below the least contrast are refused."""
    if trend.now is None:
        return []
    found = [_exposure(trend.now, trend.taught)]
    reserve = trend.now.contrast / least_contrast - 1.0
    near = (NEAR_REFUSAL - 1.0) / max(reserve, 0.01)
    if trend.taught is None:
        return [*found, _light(trend.now, None, near, least_contrast)]
    grown = growth(trend.taught, trend.now)
    parts = {Cause.FOCUS: grown.blur, Cause.LIGHT: grown.light, Cause.NOISE: grown.noise}
    largest = max(parts, key=lambda cause: parts[cause])
    parts[largest] = max(parts[largest], grown.total)
    severity = {cause: (part - 1.0) / (MOST_GROWTH - 1.0) for cause, part in parts.items()}
    return [
        *found,
        _light(trend.now, trend.taught, max(severity[Cause.LIGHT], near), least_contrast),
        _focus(trend.now, trend.taught, severity[Cause.FOCUS], grown),
        _noise(trend.now, trend.taught, severity[Cause.NOISE], grown),
    ]


def _exposure(now: Appearance, taught: Appearance | None) -> Warn:
    brighter = now.contrast / taught.contrast if taught else 1.0
    severity = max(
        (brighter - 1.0) / (MOST_GROWTH - 1.0),
        now.saturated / MOST_SATURATED,
        1.0 + (now.bright - BRIGHTEST) / (255.0 - BRIGHTEST),
    )
    was = f", {taught.bright:.0f} when taught" if taught else ""
    said = f"its bright side is at grey level {now.bright:.0f}{was}, {now.saturated:.1%} of it saturated"
    return Warn(Cause.EXPOSURE, severity, f"{said}: shorten the exposure (exposure_us), and look at the light")


def _light(now: Appearance, taught: Appearance | None, severity: float, least_contrast: float) -> Warn:
    was = f", {taught.contrast:.0f} when taught" if taught else ""
    said = f"its contrast is {now.contrast:.0f} grey levels{was}; pictures below {least_contrast:.0f} are refused"
    return Warn(Cause.LIGHT, severity, f"{said}: the light fails, or lamp or lens are dirty")


def _focus(now: Appearance, taught: Appearance, severity: float, grown: Growth) -> Warn:
    said = f"its blur is {now.blur_px:.2f} px, {taught.blur_px:.2f} when taught"
    return Warn(Cause.FOCUS, severity, f"{said}: {_noisier(grown)}: focus the lens, or clean it")


def _noise(now: Appearance, taught: Appearance, severity: float, grown: Growth) -> Warn:
    said = f"the noise beside it is {now.noise:.1f} grey levels, {taught.noise:.1f} when taught"
    return Warn(Cause.NOISE, severity, f"{said}: {_noisier(grown)}: look at the gain, and at the parts' surface")


def _noisier(grown: Growth) -> str:
    return f"its place is measured with {grown.total:.2f} times the noise"
