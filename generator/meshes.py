"""Mesh files from elsewhere, before Blender's importers see them: these believe what is claimed, and follow links."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from generator.spec import NlosError

_HEAD = 2**16
"""Bytes within which a PLY's header ends."""


@contextlib.contextmanager
def importable(path: Path) -> Iterator[Path]:
    """Give a file that Blender may import for a mesh file: itself, or a copy without its links.

    Raises
    ------
    NlosError
        It is a PLY that claims more than it can hold, for which the importer would make room.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        _check_ply(path)
    if suffix != ".obj":
        yield path
        return
    # An OBJ's material libraries may lie anywhere, and name textures anywhere; a target has a material of its own.
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
        copy = Path(folder) / path.name
        with path.open("rb") as lines, copy.open("wb") as kept:
            kept.writelines(line for line in lines if not line.lstrip().startswith(b"mtllib"))
        yield copy


def _check_ply(path: Path) -> None:
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEAD).partition(b"end_header")[0]
    for line in head.splitlines():
        words = line.split()
        if words[:1] == [b"element"] and words[-1].isdigit() and int(words[-1][:20]) > size:
            raise NlosError(f"target.mesh: {path} claims {words[-1][:20].decode()} elements in {size} bytes")
