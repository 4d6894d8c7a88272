"""Blender's values as arrays, as short decimals and as words."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from generator.model.arrays import Array, Range, Vector


def numbers(value: Any) -> Array:
    """Return a matrix, vector or colour of Blender's as float64, the same to the bit in every Blender.

    From Blender 5.0 on NumPy finds float32 in them, columns first, and would compute with that.
    """
    return np.array(value, dtype=np.float64, order="C")


def file_name() -> str:
    """Return what to call the open scene in an error: its file, if it has one."""
    return bpy.data.filepath or "scene"


def short(value: float) -> float:
    """Return the shortest decimal that Blender's float32 stands for: 0.05, not 0.05000000074505806."""
    return float(str(np.float32(value)))


def range_of(low: Array, high: Array, axis: int) -> Range:
    """Return the range along an axis, as short decimals."""
    return (short(low[axis]), short(high[axis]))


def vector(values: Any) -> Vector:
    """Return three of Blender's float32 as their shortest decimals."""
    return (short(values[0]), short(values[1]), short(values[2]))
