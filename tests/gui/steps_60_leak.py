"""Build, look, undo, five hundred times: memory stays flat, and no data-block is orphaned."""

from __future__ import annotations

from pathlib import Path

import bpy
from helpers import call, check, module, say, until

CYCLES = 500


def memory_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def blocks() -> dict[str, int]:
    kinds = ("objects", "meshes", "materials", "lights", "cameras", "images", "worlds", "collections", "node_groups")
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds}


def cycles():
    session, looking = bpy.context.window_manager.nlos, module("view.live")
    session.look = True
    yield 1.0
    used, counts = [], []
    for cycle in range(CYCLES):
        call(bpy.ops.nlos.build_scene)
        drawn = looking.pictures()
        yield from until(lambda drawn=drawn: looking.pictures() > drawn, "a picture is drawn", 10.0)
        call(bpy.ops.ed.undo)
        yield 0.01
        if cycle % 50 == 49:
            used.append(memory_mib())
            counts.append(blocks())
    session.look = False
    say("memory, MiB, every 50 cycles: " + ", ".join(f"{m:.0f}" for m in used))
    say(f"data-blocks: {counts[0]} after 50 cycles, {counts[-1]} after {CYCLES}")
    check(counts[-1] == counts[0], "no data-blocks are left over")
    check(used[-1] < used[len(used) // 2] * 1.03 + 5.0, "memory is flat over the second half")


STEPS = [cycles]
