"""Unit and axes that an FBX file states, read from its bytes: Blender's importers honour them, but do not tell."""

from __future__ import annotations

import math
import mmap
import re
import struct
from pathlib import Path

import numpy as np

from generator.model.arrays import Array
from generator.model.errors import NlosError

_CENTIMETRE = 0.01


def stated(path: Path) -> tuple[float, Array]:
    """Return the metres of one unit, and the matrix (3, 3) that turns the file's axes to x right, y forward, z up.

    ``UnitScaleFactor`` counts centimetres. The default axes are those of Maya: y up, z to the front, x to the right.

    Raises
    ------
    NlosError
        It is empty, or states a unit or axes that cannot be.
    """
    if not path.stat().st_size:
        raise NlosError(f"target.mesh: {path} is not an FBX file")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        unit = _number(data, "UnitScaleFactor", 1.0) * _CENTIMETRE
        rows = []
        for name, axis in (("Coord", 0.0), ("Front", 2.0), ("Up", 1.0)):
            sign = _number(data, f"{name}AxisSign", 1.0)
            rows.append(np.eye(3)[int(_number(data, f"{name}Axis", axis)) % 3] * np.copysign(1.0, sign))
    right, front, up = rows
    turn = np.stack([right, -front, up])
    if not (0.0 < unit < math.inf and np.isclose(np.linalg.det(turn), 1.0)):
        raise NlosError(f"target.mesh: {path} states a unit or axes that cannot be")
    return unit, turn


def _number(data: mmap.mmap, name: str, default: float) -> float:
    """Return a number of the file's global settings, in its binary or its text form."""
    text = re.search(rb'"%s"\s*,[^\n]*,\s*([-+.\deE]+)\s*$' % name.encode(), data, re.MULTILINE)
    if text:
        return float(text[1])
    at = data.find(b"S" + struct.pack("<I", len(name)) + name.encode() + b"S")
    if at < 0:
        return default
    at += 5 + len(name)
    for _ in range(3):  # type, label and flags
        if data[at : at + 1] != b"S":
            return default
        at += 5 + struct.unpack_from("<I", data, at + 1)[0]
    kind = data[at : at + 1]
    formats = {b"D": "<d", b"F": "<f", b"I": "<i", b"L": "<q"}
    return float(struct.unpack_from(formats[kind], data, at + 1)[0]) if kind in formats else default
