"""The gates that straight edges and circles share: is what was measured to be believed? Pure."""

from __future__ import annotations

import numpy as np

from cellctl.vision.features import Limits, NotFound, Singles


def accept_outline(
    contrast: float, inliers: float, residual_px: float, levels: Singles, limits: Limits, name: str
) -> None:
    """The gates that straight edges and circles share. Raises NotFound for the first that is not kept."""
    saturated = float(np.mean(levels >= 254.5))
    if saturated > limits.max_saturated:
        raise NotFound("saturation", f"{saturated:.0%} of the pixels along the {name} are at 255: shorten the exposure")
    if contrast < limits.min_contrast:
        raise NotFound(f"{name} contrast", f"{contrast:.0f} grey levels, needed are {limits.min_contrast:.0f}")
    if inliers < limits.min_inliers:
        raise NotFound(f"{name} inliers", f"{inliers:.0%} of it agree, needed are {limits.min_inliers:.0%}")
    if residual_px > limits.max_residual_px:
        raise NotFound(f"{name} residual", f"{residual_px:.2f} px, allowed are {limits.max_residual_px:.2f}")
