"""Conversion of Blender's values to arrays and short decimals, and the scene's name in messages."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from generator.model.arrays import Array, Range, Vector


def numbers(value: Any) -> Array:
    """Return a Blender matrix, vector or colour as a float64 array, identical to the bit in every Blender version.

    From Blender 5.0 on, NumPy would otherwise read them as column-major float32 and compute with that.
    """
    return np.array(value, dtype=np.float64, order="C")


def file_name() -> str:
    """Return the name of the open scene for error messages: its file, or "scene" if it has none."""
    return bpy.data.filepath or "scene"


def short(value: float) -> float:
    """Return the shortest decimal that has the same float32 value: 0.05, not 0.05000000074505806."""
    return float(str(np.float32(value)))


def range_of(low: Array, high: Array, axis: int) -> Range:
    """Return the range along an axis, as short decimals."""
    return (short(low[axis]), short(high[axis]))


def vector(values: Any) -> Vector:
    """Return three float32 values of Blender as their shortest decimals."""
    return (short(values[0]), short(values[1]), short(values[2]))
