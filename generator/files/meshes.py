"""Checks of mesh files from elsewhere, before Blender's importers read them."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from generator.model.errors import NlosError

_HEAD = 2**16
"""Bytes within which a PLY's header ends."""
_PER_BYTE = 1.0
"""Elements that a PLY may claim to hold for each of its bytes."""


@contextlib.contextmanager
def importable(path: Path) -> Iterator[Path]:
    """Yield a file that Blender may import in place of a mesh file: the file itself, or a copy without its links.

    Raises
    ------
    NlosError
        It is a PLY that claims more than it can hold. Blender 5.0.1 crashed at one.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        _check_ply(path)
    if suffix != ".obj":
        yield path
        return
    # A target has a material of its own, so an OBJ's material libraries, which may lie anywhere, are not read.
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
        copy = Path(folder) / path.name
        with path.open("rb") as lines, copy.open("wb") as output:
            output.writelines(line for line in lines if not line.lstrip().startswith(b"mtllib"))
        yield copy


def _check_ply(path: Path) -> None:
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEAD).partition(b"end_header")[0]
    for line in head.splitlines():
        words = line.split()
        if words[:1] == [b"element"] and words[-1].isdigit() and int(words[-1][:20]) > _PER_BYTE * size:
            raise NlosError(f"target.mesh: {path} claims {words[-1][:20].decode()} elements in {size} bytes")
