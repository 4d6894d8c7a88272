"""A world as a file of plain arrays: what a set was made of, to be made again without Blender."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from generator.dataset import atomic
from generator.spec import NlosError
from generator.transport.world import World

Arrays = dict[str, NDArray[Any]]

_KIND = "kind"


def save_world(path: Path, world: World) -> None:
    """Write a world as ``.npz``, by temporary name and rename: an array per figure, and nothing pickled.

    Raises
    ------
    NlosError
        The file cannot be written.
    """
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **_flatten(world))


def load_world(path: Path) -> World:
    """Read a world that `save_world` wrote.

    Raises
    ------
    NlosError
        The file is missing, or is not a world of this software.
    """
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        world: World = _unflatten(World, arrays, "")
    except FileNotFoundError:
        raise NlosError(f"{path}: no such file") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise NlosError(f"{path}: is not a world of this software ({error})") from None
    return world


def world_hash(world: World) -> str:
    """Return the SHA-256 of all figures of a world."""
    digest = hashlib.sha256()
    for name, array in sorted(_flatten(world).items()):
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        digest.update(f"{name} {little.dtype.str} {little.shape}\n".encode() + little.tobytes())
    return digest.hexdigest()


def _flatten(value: Any, name: str = "") -> Arrays:
    """Every figure inside nested dataclasses and tuples of them, by dotted name."""
    if value is None:
        return {}
    if is_dataclass(value):
        inner = {f.name: getattr(value, f.name) for f in fields(value)}
        prefix = f"{name}." if name else ""
        parts = [_flatten(part, f"{prefix}{key}") for key, part in inner.items()]
        return {k: a for part in parts for k, a in part.items()}
    if isinstance(value, tuple) and all(map(is_dataclass, value)):
        # Which kind of body each is, in order; so an empty tuple leaves its trace too.
        parts = [{f"{name}.{_KIND}": np.array([type(part).__name__ for part in value], dtype=np.str_)}]
        parts += [_flatten(part, f"{name}.{i}") for i, part in enumerate(value)]
        return {k: a for part in parts for k, a in part.items()}
    return {name: np.asarray(value)}


def _unflatten(hint: Any, arrays: Arrays, name: str) -> Any:
    if type(None) in get_args(hint):
        there = any(key.startswith(f"{name}.") for key in arrays)
        return _unflatten(get_args(hint)[0], arrays, name) if there else None
    if is_dataclass(hint) and isinstance(hint, type):
        prefix = f"{name}." if name else ""
        return hint(**{key: _unflatten(part, arrays, f"{prefix}{key}") for key, part in get_type_hints(hint).items()})
    if get_origin(hint) is tuple and get_args(hint)[-1] is Ellipsis:
        kinds = {kind.__name__: kind for kind in get_args(get_args(hint)[0]) or (get_args(hint)[0],)}
        named = arrays[f"{name}.{_KIND}"].tolist()
        return tuple(_unflatten(kinds[kind], arrays, f"{name}.{i}") for i, kind in enumerate(named))
    if get_origin(hint) is tuple:
        return tuple(arrays[name].tolist())
    return hint(arrays[name]) if hint in (int, float, bool) else arrays[name]
