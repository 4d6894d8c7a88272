"""Draws difference pictures like the paper's figures 2 to 4: amplified, in metres on the wall, above noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from generator.measure import figures
from generator.model.arrays import Array
from generator.model.quantities import radiance

_QUANTILE = 0.995
_DROWNED = "#eceff1"


@dataclass(frozen=True)
class Block:
    """The difference pictures under one light.

    Attributes
    ----------
    name : str
    rows : ndarray of shape (3, k, height, width)
        A row of differences for each axis, W/m^2/sr.
    noise : ndarray of shape (3, k)
        Root mean square of each picture's noise, or of its rounding errors, W/m^2/sr; NaN where it is not known.
    drowned : ndarray of shape (3, k), bool
        Whether the noise is above the signal.
    full_scale : float
        Radiance that the amplification is relative to, W/m^2/sr.
    corners : ndarray of shape (4, 2)
        Where the picture's corners lie on the wall, x and z, metres: top right, bottom right, bottom left, top left.
    threshold : str
        What the noise is, in words.
    columns, axes : sequence of str
        Heading of each column, and name of each row.
    """

    name: str
    rows: Array
    noise: Array
    drowned: NDArray[np.bool_]
    full_scale: float
    corners: Array
    threshold: str
    columns: Sequence[str]
    axes: Sequence[str]


@figures.styled
def draw(path: Path, title: str, blocks: Sequence[Block]) -> list[Path]:
    """Write the difference pictures of an experiment, and return the files.

    The pictures of a row have one scale, with a colour bar. Where noise drowns the signal, nothing is drawn.

    Parameters
    ----------
    path : Path
    title : str
    blocks : sequence of Block
    """
    across = min(2, len(blocks))
    down = -(-len(blocks) // across)
    figure = Figure(figsize=(across * (1.55 * len(blocks[0].columns) + 1.6), down * 5.6 + 0.5))
    figure.suptitle(title)
    parts = figure.subfigures(down, across, squeeze=False).flat
    for part, block in zip(parts, blocks, strict=False):
        part.suptitle(f"{block.name}; noise: {block.threshold}", fontsize=9)
        _draw_block(part, block)
    return figures.save(path, figure)


def _draw_block(part: Any, block: Block) -> None:
    x, z = on_wall(block.corners, *block.rows.shape[2:])
    axes = part.subplots(len(block.rows), len(block.columns), squeeze=False, sharex=True, sharey=True)
    rows = zip(axes, block.rows, block.noise, block.drowned, block.axes, strict=True)
    for line, pictures, noise, drowned, name in rows:
        peak = float(np.quantile(np.abs(pictures[~drowned]), _QUANTILE)) if not drowned.all() else 0.0
        for panel, picture, error, lost in zip(line, pictures, noise, drowned, strict=True):
            panel.grid(visible=False)
            panel.set(aspect="equal", xlim=(x.max(), x.min()), ylim=(z.min(), z.max()))  # as the camera sees it
            if lost or not peak:
                panel.set_facecolor(_DROWNED)
                rms = np.sqrt((picture**2).mean())
                words = f"below noise\nrms {radiance(rms, 1)}\nnoise {radiance(error, 1)}" if lost else "no change"
                panel.text(0.5, 0.5, words, ha="center", va="center", transform=panel.transAxes, fontsize=7)
                continue
            limits = {"vmin": -peak, "vmax": peak, "cmap": figures.SIGNED}
            mesh = panel.pcolormesh(x, z, picture, rasterized=True, **limits)
        line[0].set_ylabel(f"{name}\nz (m)")
        if peak:
            bar = part.colorbar(mesh, ax=line.tolist(), shrink=0.9, format="%.1e")
            bar.set_label(f"W/m²/sr; × {block.full_scale / peak:.3g}", fontsize=8)
            bar.ax.tick_params(labelsize=7)
    for panel, column in zip(axes[0], block.columns, strict=True):
        panel.set_title(column)
    for panel in axes[-1]:
        panel.set_xlabel("x on the wall (m)", fontsize=8)
        panel.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))


def on_wall(corners: Array, height: int, width: int) -> tuple[Array, Array]:
    """Return where the corners of a picture's pixels lie on the wall.

    The projection of a plane is a homography, which four points determine (Hartley and Zisserman 2004, section 4.1).

    Parameters
    ----------
    corners : ndarray of shape (4, 2)
        As in `Block`.
    height, width : int

    Returns
    -------
    x, z : ndarray of shape (height + 1, width + 1)
        Metres; row 0 is the top of the picture.
    """
    system = []
    for (right, down), (x, z) in zip(((1, 0), (1, 1), (0, 1), (0, 0)), corners, strict=True):
        system.append([right, down, 1, 0, 0, 0, -right * x, -down * x])
        system.append([0, 0, 0, right, down, 1, -right * z, -down * z])
    matrix = np.append(np.linalg.solve(np.array(system, float), np.ravel(corners)), 1.0).reshape(3, 3)
    across, along = np.meshgrid(np.linspace(0.0, 1.0, width + 1), np.linspace(0.0, 1.0, height + 1))
    x, z, scale = np.einsum("ij,jkl->ikl", matrix, np.array([across, along, np.ones_like(across)]))
    return x / scale, z / scale
