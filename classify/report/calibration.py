"""Files of a calibration: what stays uncertain, and what the fit leaves of the pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from classify.calibration.fit import Calibration
from classify.calibration.measured import Measured
from generator.files.pictures import write_picture
from generator.files.uncertainty_file import write_uncertainty
from generator.measure import figures
from generator.model.uncertainty import RELATIVE, Furniture, Uncertainty
from generator.transport.parameters import OFFSETS

SCENE = frozenset(OFFSETS)
"""Names of what is of the scene, and not of the camera or of a single picture."""
_LIMIT = 4.0
"""Residual, in standard deviations, at which the colours of the figure end."""


def write(folder: Path, found: Calibration, seen: Measured, furniture: Furniture | None = None) -> list[Path]:
    """Write ``uncertainty.toml``, ``residuals.png`` and a picture of each residual into a folder; return their paths.

    Values of the camera and of single pictures are integrated out of the uncertainty. Relative deviations are shares
    of the calibrated scene's values. Furniture that nobody knows stays unknown.
    """
    kept = [k for k, name in enumerate(found.names) if name in SCENE]
    names = [found.names[k] for k in kept]
    relative = [name in RELATIVE for name in names]
    scale = np.where(relative, 1.0 / (1.0 + found.offsets[kept]), 1.0)
    covariance = found.covariance[np.ix_(kept, kept)] * np.outer(scale, scale)
    written = []
    if kept:
        uncertainty = replace(Uncertainty.of_covariance(names, covariance), furniture=furniture)
        written.append(folder / "uncertainty.toml")
        write_uncertainty(written[-1], uncertainty)
    for number, (measured, expected) in enumerate(zip(seen.pictures, found.expected, strict=True)):
        written.append(folder / ("residual-empty.exr" if number == 0 else f"residual-{number}.exr"))
        left = np.repeat((measured - expected)[..., None], 3, axis=2).astype(np.float32)
        write_picture(written[-1], left, {"about": "measured minus expected, W/m^2/sr"})
    return [*written, *figures.save(folder / "residuals.png", draw(found, seen))]


@figures.styled
def draw(found: Calibration, seen: Measured) -> Figure:
    """Return measured pictures above what the fit leaves of them."""
    count = len(found.residuals)
    figure, axes = figures.subplots(2, count, size=(figures.WIDTH, 2.0 + 2.0 * figures.WIDTH / max(3, count) * 0.8))
    for number, (above, below) in enumerate(axes.T):
        shown = seen.pictures[number] - (seen.pictures[0] if number else 0.0)
        above.imshow(shown, cmap="viridis")
        above.set_title("empty scene" if number == 0 else f"{number}: with object, minus empty")
        image = below.imshow(found.residuals[number], cmap="RdBu_r", vmin=-_LIMIT, vmax=_LIMIT)
        below.set_title(f"left: {np.sqrt((found.residuals[number] ** 2).mean()):.2f} standard deviations rms")
        for axis in (above, below):
            axis.set_xticks([])
            axis.set_yticks([])
    figure.colorbar(image, ax=list(axes[1]), label="measured minus expected, standard deviations", shrink=0.8)
    return figure
