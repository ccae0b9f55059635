"""The gates that straight edges and circles share: is what was measured to be believed? Pure."""

from __future__ import annotations

import numpy as np

from cellctl.vision.features import Appearance, Floats, Limits, NotFound
from cellctl.vision.profile import saturated
from cellctl.vision.strip import Part, Strip


def check_seen(strip: Strip, part: Part, weights: Floats, fewest: int, limits: Limits, name: str) -> None:
    """Raises NotFound when fewer blocks than that are to be believed."""
    seen = np.count_nonzero(weights)
    if seen < fewest:
        _check_saturation(saturated(strip, part), limits, name)
        raise NotFound(name, f"{seen} of {len(weights)} stretches of its outline see it, needed are {fewest}")


def check_in_view(first: int, last: int, expected: float, limits: Limits, name: str) -> None:
    """Raises NotFound when too little of an edge that should run over so many px along is in the picture."""
    share = max(0, last - first) / max(abs(expected), 1.0)
    if share < limits.min_in_view:
        raise NotFound("view", f"{share:.0%} of the {name} are in the picture, needed are {limits.min_in_view:.0%}")


def accept_outline(look: Appearance, inliers: float, residual_px: float, limits: Limits, name: str) -> None:
    """The gates that straight edges and circles share. Raises NotFound for the first that is not kept."""
    _check_saturation(look.saturated, limits, name)
    if look.contrast < limits.min_contrast:
        raise NotFound(f"{name} contrast", f"{look.contrast:.0f} grey levels, needed are {limits.min_contrast:.0f}")
    if look.blur_px > limits.max_blur_px:
        raise NotFound(f"{name} blur", f"{look.blur_px:.1f} px, allowed are {limits.max_blur_px:.1f}: out of focus?")
    if inliers < limits.min_inliers:
        raise NotFound(f"{name} inliers", f"{inliers:.0%} of it agree, needed are {limits.min_inliers:.0%}")
    if residual_px > limits.max_residual_px:
        raise NotFound(f"{name} residual", f"{residual_px:.2f} px, allowed are {limits.max_residual_px:.2f}")


def _check_saturation(share: float, limits: Limits, name: str) -> None:
    if share > limits.max_saturated:
        detail = (
            f"{share:.0%} of the {name} are over-exposed, allowed are {limits.max_saturated:.0%}: shorten the exposure"
        )
        raise NotFound("saturation", detail)
