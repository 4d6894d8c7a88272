"""Objects that no method was trained on: ``python benchmarks/shapes.py DIR`` writes cone.ply and chair.ply there."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from generator.files.writing import write_text

Corner = tuple[float, float, float]
Face = tuple[int, ...]


def cone(radius: float = 0.2, height: float = 0.5, sides: int = 24) -> tuple[list[Corner], list[Face]]:
    """Return the corners, metres, and faces of a cone that stands on its base."""
    turns = [2.0 * math.pi * k / sides for k in range(sides)]
    corners = [(radius * math.cos(t), radius * math.sin(t), 0.0) for t in turns] + [(0.0, 0.0, height)]
    return corners, [*[(k, (k + 1) % sides, sides) for k in range(sides)], tuple(reversed(range(sides)))]


def chair(
    seat: float = 0.34, height: float = 0.75, leg: float = 0.04, board: float = 0.03
) -> tuple[list[Corner], list[Face]]:
    """Return the corners, metres, and faces of a small chair: four legs, a seat at 55 % of its height, a back."""
    level, far = 0.55 * height, seat - leg
    boxes = [((x, y, 0.0), (leg, leg, level)) for x in (0.0, far) for y in (0.0, far)]
    boxes += [((0.0, 0.0, level), (seat, seat, board))]
    boxes += [((0.0, seat - board, level + board), (seat, board, height - level - board))]
    corners: list[Corner] = []
    faces: list[Face] = []
    for low, size in boxes:
        first = len(corners)
        corners += [
            (low[0] + i * size[0], low[1] + j * size[1], low[2] + k * size[2])
            for k in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ]
        sides = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
        faces += [tuple(first + corner for corner in side) for side in sides]
    return corners, faces


def ply(corners: Sequence[Corner], faces: Sequence[Face]) -> str:
    """Return a mesh as a PLY file (z up)."""
    lines = ["ply", "format ascii 1.0", f"element vertex {len(corners)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{value:.6g}" for value in corner) for corner in corners]
    lines += [" ".join(map(str, (len(face), *face))) for face in faces]
    return "\n".join(lines) + "\n"


def write(folder: Path) -> None:
    """Write both shapes into a folder."""
    for name, shape in {"cone": cone(), "chair": chair()}.items():
        write_text(folder / f"{name}.ply", ply(*shape))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write cone.ply and chair.ply.")
    parser.add_argument("folder", type=Path)
    write(parser.parse_args().folder)
