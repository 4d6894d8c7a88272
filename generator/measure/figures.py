"""Draws difference pictures like the paper's figures 2 to 4: amplified, with the factor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from generator.files.writing import atomic
from generator.model.arrays import Array

_QUANTILE = 0.995


def save(path: Path, figure: Figure) -> None:
    """Write a figure as a PNG, by temporary name and rename, and close it."""
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)
    plt.close(figure)


def experiment(
    path: Path, title: str, blocks: Sequence[tuple[str, Array]], columns: Sequence[str], signal: Sequence[float]
) -> None:
    """Write the difference pictures of an experiment as a PNG, by temporary name and rename.

    Parameters
    ----------
    path : Path
    title : str
    blocks : sequence of (str, ndarray of shape (3, k, height, width))
        Name of the light, and a row of differences for each axis, W/m^2/sr.
    columns : sequence of str
        Heading of each column.
    signal : sequence of float
        Full-scale radiance of each block, W/m^2/sr; amplification is relative to it.
    """
    count = len(columns)
    across = min(2, len(blocks))
    down = -(-len(blocks) // across)
    figure = plt.figure(figsize=(across * (1.3 * count + 0.4), down * 4.7 + 0.4), layout="constrained")
    figure.suptitle(title, fontsize=10)
    parts = figure.subfigures(down, across, squeeze=False).flat
    for part, (name, rows), full_scale in zip(parts, blocks, signal, strict=False):
        part.suptitle(name, fontsize=10)
        axes = part.subplots(len(rows), count, squeeze=False)
        for line, (axis, row) in enumerate(zip("xyz", rows, strict=True)):
            axes[line][0].set_ylabel(axis, fontsize=9, rotation=0, labelpad=8)
            for panel, picture in zip(axes[line], row, strict=True):
                peak = float(np.quantile(np.abs(picture), _QUANTILE))
                panel.imshow(picture, cmap="RdBu_r", vmin=-(peak or 1.0), vmax=peak or 1.0)
                panel.set_xticks([])
                panel.set_yticks([])
                panel.set_xlabel(f"×{full_scale / peak:.3g}" if peak else "no change", fontsize=8, labelpad=2)
        for panel, column in zip(axes[0], columns, strict=True):
            panel.set_title(column, fontsize=8)
    save(path, figure)
