"""How far the pictures of one row are from those of another."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from generator.sets.dataset import Dataset

SAME = 1e-12
"""Relative to the brightest pixel, for `surfel`, which has no noise."""
ROUNDING = 1e-5
"""Relative to the brightest pixel, for Cycles with the same random numbers, which computes in float32."""
T = 4.0
"""Student's t that Cycles' pictures may reach: with 35 degrees of freedom, one time in three thousand."""


def compared(one: Path, other: Path, engine: str) -> tuple[bool, str]:
    """Compare two data sets of one sweep.

    Where Cycles has drawn other random numbers, its pictures are judged by what is independent from pose to pose: the
    mean of the pixels of each difference picture, with the object minus without.

    Returns
    -------
    good : bool
        The same, or within what noise explains.
    words : str
        What was found.
    """
    a, b = Dataset.open(one), Dataset.open(other)
    if [(p.voxel, p.file, p.seed) for p in a.poses] != [(p.voxel, p.file, p.seed) for p in b.poses]:
        return False, "other poses"
    places = [np.array([[*p.position, *p.rotation] for p in s.poses]) for s in (a, b)]
    moved = float(np.abs(places[0] - places[1]).max())
    if moved > SAME:
        return False, f"poses differ by {moved:.1g} m or rad"
    p, q = (np.array([s.picture(pose) for pose in s.poses], dtype=float) for s in (a, b))
    equal = sum(x.pixel_hash == y.pixel_hash for x, y in zip(a.poses, b.poses, strict=True))
    if equal == len(p):
        return True, f"all {len(p)} are the same to the bit"
    far = float(np.abs(p - q).max() / np.abs(p).max())
    words = f"{equal} of {len(p)} are the same to the bit; the largest difference is {far:.0e} of the brightest pixel"
    if engine == "surfel":
        return far <= SAME, words
    if far <= ROUNDING:
        return True, f"{words}, so the noise is the same"
    d, e = (x - s.background().astype(float) for x, s in ((p, a), (q, b)))
    change = (e - d).mean(axis=(1, 2, 3))
    level = float(d.mean())
    error = float(change.std(ddof=1) / np.sqrt(len(change)))
    t = float(change.mean()) / error if error else 0.0
    words += f", so the noise is another; mean signal {100 * change.mean() / level:+.2g} % ({t:+.1f} standard errors)"
    return abs(t) < T, words
