"""Draws difference pictures as the paper's figures 2 to 4 have them: amplified, and by how much."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from generator.files.writing import atomic
from generator.model.arrays import Array

_QUANTILE = 0.995


def save(path: Path, figure: Figure) -> None:
    """Write a figure as a PNG, by temporary name and rename, and let go of it."""
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
        What the light is, and a row of differences for each axis, W/m^2/sr.
    columns : sequence of str
        What stands over each column.
    signal : sequence of float
        Of each block: radiance that counts as full scale, W/m^2/sr; amplification is relative to it.
    """
    wide = len(columns)
    across = min(2, len(blocks))
    down = -(-len(blocks) // across)
    figure = plt.figure(figsize=(across * (1.3 * wide + 0.4), down * 4.7 + 0.4), layout="constrained")
    figure.suptitle(title, fontsize=10)
    parts = figure.subfigures(down, across, squeeze=False).flat
    for part, (name, rows), full in zip(parts, blocks, signal, strict=False):
        part.suptitle(name, fontsize=10)
        axes = part.subplots(len(rows), wide, squeeze=False)
        for line, (axis, row) in enumerate(zip("xyz", rows, strict=True)):
            axes[line][0].set_ylabel(axis, fontsize=9, rotation=0, labelpad=8)
            for at, picture in zip(axes[line], row, strict=True):
                top = float(np.quantile(np.abs(picture), _QUANTILE))
                at.imshow(picture, cmap="RdBu_r", vmin=-(top or 1.0), vmax=top or 1.0)
                at.set_xticks([])
                at.set_yticks([])
                at.set_xlabel(f"×{full / top:.3g}" if top else "no change", fontsize=8, labelpad=2)
        for at, column in zip(axes[0], columns, strict=True):
            at.set_title(column, fontsize=8)
    save(path, figure)
