"""A world as a file of plain arrays, from which a data set can be made again without Blender."""

from __future__ import annotations

import hashlib
import math
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from generator.files.limits import check_archive
from generator.files.writing import atomic
from generator.model.errors import NlosError
from generator.model.quantities import ALL_ORDERS
from generator.transport.world import Emitters, Gloss, Mesh, World

Arrays = dict[str, NDArray[Any]]

_KIND = "kind"
_OF_AMBIENT, _WALL = "ambient.", "ambient.wall."
"""The relay wall keeps the names that it had as a part of ambient light, so that older files and hashes hold."""


def save_world(path: Path, world: World) -> None:
    """Write a world as ``.npz``, under a temporary name and then renamed: one array per value, nothing pickled.

    Raises
    ------
    NlosError
        The file cannot be written.
    """
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **_named(world))


def load_world(path: Path) -> World:
    """Read a world that `save_world` wrote.

    Raises
    ------
    NlosError
        The file is missing, or is not a world of this software.
    """
    try:
        check_archive(path)
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name.removeprefix(_OF_AMBIENT) if _WALL in name else name: file[name] for name in file.files}
        world: World = _unflatten(World, arrays, "")
        _check(world)
    except FileNotFoundError:
        raise NlosError(f"{path}: no such file") from None
    except Exception as error:  # of many types: from the archive, its arrays, or the text of their headers
        raise NlosError(f"{path}: is not a world of this software ({error})") from None
    return world


_SHAPES = {"to_wall": (4, 3), "eye": (4,), "triangles": (-1, 3, 3), "softness": (-1,), "roughness": (-1,)}
"""Shapes of the arrays that are neither vector nor colour; -1 stands for any length."""


def _check(world: World) -> None:
    """Raise ValueError unless all arrays have the shapes that compiled code, which checks no bounds, expects."""
    lit = tuple(part for part in (world.ambient, world.wall, world.emitters) if part is not None)
    glosses = [body.gloss for body in world.target if body.gloss is not None]
    for body in (world.patch, world.watched, *world.target, *world.room, *lit, *glosses):
        for field in fields(body):
            value = getattr(body, field.name)
            if field.name in ("resolution", "gloss"):
                continue
            if isinstance(value, float):
                if not math.isfinite(value):
                    raise ValueError(f"{field.name} must be finite")
                continue
            expected = _SHAPES.get(field.name, (-1, 3) if isinstance(body, Emitters | Gloss | Mesh) else (3,))
            shape = value.shape if isinstance(value, np.ndarray) and value.dtype.kind == "f" else ()
            if len(shape) != len(expected) or any(w not in (-1, n) for n, w in zip(shape, expected, strict=True)):
                raise ValueError(f"{field.name} must be numbers of shape {expected}")
            if not np.isfinite(value).all():
                raise ValueError(f"{field.name} must be finite")
    if not 1 <= world.order <= ALL_ORDERS or not all(1 <= n <= 65536 for n in world.watched.resolution):
        raise ValueError("its order or resolution cannot be")


def world_hash(world: World) -> str:
    """Return the SHA-256 of all values of a world."""
    digest = hashlib.sha256()
    for name, array in sorted(_named(world).items()):
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        digest.update(f"{name} {little.dtype.str} {little.shape}\n".encode() + little.tobytes())
    return digest.hexdigest()


def _named(world: World) -> Arrays:
    """Return every value of a world by its name in files."""
    arrays = _flatten(world if world.is_followed_on else replace(world, wall=None)).items()
    return {f"{_OF_AMBIENT}{name}" if name.startswith("wall.") else name: array for name, array in arrays}


def _flatten(value: Any, name: str = "") -> Arrays:
    """Return every value inside nested dataclasses and tuples of them, by dotted name."""
    if value is None:
        return {}
    if is_dataclass(value):
        values = {f.name: getattr(value, f.name) for f in fields(value)}
        prefix = f"{name}." if name else ""
        parts = [_flatten(part, f"{prefix}{key}") for key, part in values.items()]
        return {k: a for part in parts for k, a in part.items()}
    if isinstance(value, tuple) and all(map(is_dataclass, value)):
        # The kinds of the bodies, in order; the array is written for an empty tuple too.
        parts = [{f"{name}.{_KIND}": np.array([type(part).__name__ for part in value], dtype=np.str_)}]
        parts += [_flatten(part, f"{name}.{i}") for i, part in enumerate(value)]
        return {k: a for part in parts for k, a in part.items()}
    return {name: np.asarray(value)}


def _unflatten(hint: Any, arrays: Arrays, name: str) -> Any:
    if type(None) in get_args(hint):
        present = any(key.startswith(f"{name}.") for key in arrays)
        return _unflatten(get_args(hint)[0], arrays, name) if present else None
    if is_dataclass(hint) and isinstance(hint, type):
        prefix = f"{name}." if name else ""
        return hint(**{key: _unflatten(part, arrays, f"{prefix}{key}") for key, part in get_type_hints(hint).items()})
    if get_origin(hint) is tuple and get_args(hint)[-1] is Ellipsis:
        kinds = {kind.__name__: kind for kind in get_args(get_args(hint)[0]) or (get_args(hint)[0],)}
        names = arrays[f"{name}.{_KIND}"].tolist()
        return tuple(_unflatten(kinds[kind], arrays, f"{name}.{i}") for i, kind in enumerate(names))
    if get_origin(hint) is tuple:
        return tuple(arrays[name].tolist())
    return hint(arrays[name]) if hint in (int, float, bool) else arrays[name]
