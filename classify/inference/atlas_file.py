"""An atlas as an HDF5 file."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from classify.inference.atlas import Atlas
from classify.inference.uncertain import Uncertain
from classify.pictures.feature_table import numbers, open_table
from classify.pictures.sensor import Sensor
from generator.files.toml import from_dict, to_dict
from generator.files.writing import atomic
from generator.model.grid import VoxelGrid

FORMAT = 3
"""Up to format 2, no scene was uncertain; such atlases are still written as 2, so that older versions read them."""

_ABSURD = 1e15
"""Bound far above any number in an atlas, whose square is still finite."""

_ARRAYS: dict[str, type[Any]] = {
    **dict.fromkeys(("codes", "basis", "nuisances"), np.float32),
    **dict.fromkeys(("background", "positions", "rotations"), np.float64),
    **dict.fromkeys(("voxels", "kinds"), np.int64),
}

_UNCERTAIN: dict[str, type[Any]] = {
    **dict.fromkeys(("slopes", "scatter", "basis"), np.float32),
    "left": np.float64,
}
_OF_UNCERTAIN = "uncertain_"


def save(path: Path, atlas: Atlas) -> None:
    """Write an atlas to a temporary HDF5 file, and rename it."""
    with atomic(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = 2 if atlas.uncertain is None else FORMAT
        file.attrs["kind"] = "atlas"
        file.attrs["grid"] = json.dumps(to_dict(atlas.grid))
        file.attrs["sensor"] = json.dumps(asdict(atlas.sensor))
        file.attrs["left_out"] = atlas.left_out
        file.attrs["spread"] = atlas.spread
        file.attrs["about"] = json.dumps(atlas.about)
        for name in _ARRAYS:
            file[name] = getattr(atlas, name)
        if atlas.hiding is not None:
            file["hiding"] = atlas.hiding
        if atlas.uncertain is not None:
            for name in _UNCERTAIN:
                file[f"{_OF_UNCERTAIN}{name}"] = getattr(atlas.uncertain, name)
        file["codes"].attrs["about"] = "difference pictures in units of the sensor's noise, projected on the basis"
        file["positions"].attrs["units"] = "m"
        file["rotations"].attrs["units"] = "degrees about x, y, z"


def load(path: Path) -> Atlas:
    """Read an atlas.

    Raises
    ------
    NlosError
        If the file is missing, has a newer format, or is not an atlas.
    """
    with open_table(path, "atlas", FORMAT) as file:
        atlas = Atlas(
            **{name: numbers(file, name, kind) for name, kind in _ARRAYS.items()},
            grid=from_dict(VoxelGrid, json.loads(str(file.attrs["grid"])), "grid."),
            sensor=from_dict(Sensor, json.loads(str(file.attrs["sensor"])), "sensor."),
            left_out=float(file.attrs["left_out"]),
            spread=float(file.attrs["spread"]),
            about=json.loads(str(file.attrs["about"])),
            hiding=numbers(file, "hiding", np.float32) if "hiding" in file else None,
            uncertain=_uncertain(file) if f"{_OF_UNCERTAIN}scatter" in file else None,
        )
        _check(atlas)
    return atlas


def _uncertain(file: Any) -> Uncertain:
    return Uncertain(**{name: numbers(file, f"{_OF_UNCERTAIN}{name}", kind) for name, kind in _UNCERTAIN.items()})


def _check(atlas: Atlas) -> None:
    """Raise ValueError if the contents of a file cannot be an atlas."""
    n, k = atlas.codes.shape
    shapes = [atlas.basis.shape, atlas.positions.shape, atlas.rotations.shape, atlas.voxels.shape]
    shapes += [atlas.nuisances.shape[1:], atlas.kinds.shape]
    expected = [(k, atlas.background.size), (n, 3), (n, 3), (n,), (k,), (n,)]
    if atlas.background.ndim != 2 or shapes != expected or not n:
        raise ValueError("its codes, basis and poses differ in length")
    if atlas.hiding is not None and atlas.hiding.shape != (n, k):
        raise ValueError("its codes of light and of shadow differ in number")
    arrays = [getattr(atlas, name) for name in (*_ARRAYS, *["hiding"] * atlas.unknown)]
    if (own := atlas.uncertain) is not None:
        arrays += [getattr(own, name) for name in _UNCERTAIN]
        p, r = (part.shape[1] if part.ndim == 3 else -1 for part in (own.slopes, own.scatter))
        shapes = [own.slopes.shape, own.scatter.shape, own.basis.shape]
        if shapes != [(n, p, k), (n, r, k), (p, atlas.background.size)] or own.left.ndim != 1 or len(own.left) < 20:
            raise ValueError("what is uncertain of it differs in length")
    if not all((np.abs(array) < _ABSURD).all() for array in arrays):
        raise ValueError("it holds NaN, infinite or absurdly large values")
    targets = atlas.about["targets"]
    if not (isinstance(targets, list) and all(isinstance(target, str) for target in targets)):
        raise ValueError("it does not name its targets")
    if not (0.0 < atlas.spread < math.inf and 0.0 <= atlas.left_out < math.inf):
        raise ValueError("its spread or what it leaves out is no positive number")
    if atlas.kinds.min() < 0 or atlas.kinds.max() >= len(targets):
        raise ValueError("it names a target that it does not describe")
    tolerance = 1e-6 * np.subtract(atlas.grid.hi, atlas.grid.lo)
    low, high = atlas.positions.min(axis=0), atlas.positions.max(axis=0)
    if (low < atlas.grid.lo - tolerance).any() or (high > atlas.grid.hi + tolerance).any():
        raise ValueError("it has poses outside its grid")
    if atlas.voxels.min() < 0 or atlas.voxels.max() >= atlas.grid.n_voxels:
        raise ValueError(f"it names a voxel that its grid of {atlas.grid.n_voxels} lacks")
