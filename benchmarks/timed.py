"""Time one row of `speed_table` in the tree whose ``generator`` is found first; prints seconds as JSON.

Run by `speed_table`: ``python benchmarks/timed.py JOB``, a pickle that holds nothing but numbers, so that trees of
other revisions can read it. A world that a tree cannot describe, or refuses, gives null.
"""

from __future__ import annotations

import json
import pickle
import statistics
import sys
import time
from pathlib import Path
from typing import Any


def world_of(transport: Any, told: dict[str, Any]) -> Any:
    """Return a tree's world; raises AttributeError or TypeError if it has no such thing."""
    bodies = {
        name: [getattr(transport, kind)(**fields) for kind, fields in told[name]] for name in ("target", "room")
    }
    more = {name: getattr(transport, kind)(**fields) for name, (kind, fields) in told["more"].items()}
    patch, watched = transport.LitPatch(**told["patch"]), transport.Watched(**told["watched"])
    return transport.World(
        patch, watched, tuple(bodies["target"]), tuple(bodies["room"]), order=told["order"], **more
    )


def seconds(job: dict[str, Any]) -> float | None:
    """Return the processor time of a picture, or None."""
    if not job["numba"]:
        sys.modules["numba"] = None  # type: ignore[assignment]
    start = time.process_time()
    from generator import transport

    try:
        engine = transport.Transport(world_of(transport, job["world"]), accuracy=job["accuracy"], threads=1)
        if job["way"] == "draft":
            engine = type(engine)(engine.world, accuracy=3.0 * job["accuracy"], threads=1, like=engine, draft=True)
        else:
            engine.background()
        if job["way"] == "first":
            engine.render(*job["poses"][0])
            return time.process_time() - start
        if job["way"] == "batch":
            places, turns = zip(*job["poses"], strict=True)
            engine.pictures(places[::-1], turns)
            start = time.process_time()
            engine.pictures(places, turns)
            return (time.process_time() - start) / len(places)
        draw = engine.difference if hasattr(engine, "difference") else engine.render
        draw(*job["poses"][0])
        taken = []
        for pose in job["poses"][1:] if job["numba"] else job["poses"]:  # the first one compiles
            start = time.process_time()
            draw(*pose)
            taken.append(time.process_time() - start)
    except Exception as error:  # of whatever kind a tree has
        print(f"  not there: {type(error).__name__}: {error}", file=sys.stderr)
        return None
    return statistics.median(taken) if job["way"] == "alone" else max(taken)


if __name__ == "__main__":
    print(json.dumps(seconds(pickle.loads(Path(sys.argv[1]).read_bytes()))))
