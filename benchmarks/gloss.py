"""A glossy target by the engine `surfel`: time and error by roughness, and Cycles' picture of the same scene.

Run: ``python benchmarks/gloss.py -o DIR``. The wall of the preset `room` alone, lit by a spot of 4 degrees, with a
sphere, a sheet and a box of Blender's Glossy BSDF (Multiscatter GGX), whose highlight is in the picture. Times are
medians of five pictures of 64 x 64 pixels at 1 %, processor time; errors are those of the same pictures against an
accuracy of 1e-3, root mean square. Cycles renders by the engine `patch`.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import results

RESULTS = {
    "gloss": (
        "target",
        "roughness",
        "processor time, ms",
        "error at 1 %, per cent",
        "Cycles' mean less the engine's, per cent",
        "its 95 % interval",
    )
}
ROUGHNESSES = (0.2, 0.3, 0.5, 0.7, 1.0)
POSE = (1.2, 1.0, 1.3), (0.0, 0.0, -50.0)
"""At this angle a flat target mirrors the lit patch into the picture."""
_BOX = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box(path: Path) -> Path:
    """Write a box of 0.3 x 0.2 x 0.4 m as a mesh file."""
    corners = [(x, y, z) for x in (-0.15, 0.15) for y in (-0.1, 0.1) for z in (-0.2, 0.2)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in _BOX]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def built(target: Any, pixels: int) -> Any:
    """Return Blender's scene with a target before the bare wall."""
    from generator.blender.scene import blend_file, build, posing
    from generator.model.presets import preset

    room = preset("room")
    spot = replace(room.spot, half_angle=4.0)  # as wide as the picture lets it be: Cycles' noise falls with it
    scene = replace(room, target=target, spot=spot, room=None, partition=None, resolution=(pixels, pixels))
    blender = blend_file.new_file()
    build.build(blender, scene)
    posing.move_target(blender, *POSE)
    return blender


def times_and_error(target: Any) -> tuple[float, float]:
    """Return the median processor time, seconds, of a picture at 1 %, and its error."""
    from generator.blender.engines.survey import surfel_world
    from generator.transport import Transport

    world = surfel_world(built(target, 64))
    fine, coarse = (Transport(world, accuracy=accuracy, threads=1) for accuracy in (1e-3, 1e-2))
    expected, got, seconds = fine.difference(*POSE), coarse.difference(*POSE), []
    for _ in range(5):
        start = time.process_time()
        coarse.difference(*POSE)
        seconds.append(time.process_time() - start)
    error = math.sqrt(((got - expected) ** 2).mean() / (expected**2).mean())
    return float(np.median(seconds)), error


def against_cycles(target: Any, samples: int, seeds: int) -> tuple[float, float]:
    """Return the mean of Cycles' picture less the engine's, relative to it, and the half width of its interval."""
    from scipy.stats import t

    from generator.blender.engines import renderers

    blender, size = built(target, 16), (16, 16)
    with renderers.opened(blender, "surfel", resolution=size, accuracy=1e-3) as renderer:
        ours = float(renderer.render().mean())
    with renderers.opened(blender, "patch", resolution=size) as renderer:
        means = [float(renderer.render(samples=samples, seed=seed).mean()) for seed in range(seeds)]
    half = t.ppf(0.975, seeds - 1) * np.std(means, ddof=1) / math.sqrt(seeds)
    return float(np.mean(means)) / ours - 1.0, half / ours


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results")
    parser.add_argument(
        "--samples", type=int, default=4096, help="of Cycles, a pixel and picture (default: %(default)s)"
    )
    parser.add_argument("--seeds", type=int, default=6, help="pictures by Cycles (default: %(default)s)")
    args = parser.parse_args()
    from generator.model.scene import Target

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        mesh = str(box(Path(folder) / "box.obj"))
        targets = {
            "sphere": Target(kind="sphere", size=0.4, albedo=0.8, gloss=1.0),
            "sheet": Target(kind="sheet", size=0.5, albedo=0.8, gloss=1.0),
            "box": Target(kind="mesh", size=0.0, albedo=0.8, gloss=1.0, mesh=mesh),
        }
        for name, target in targets.items():
            for roughness in ROUGHNESSES:
                rough = replace(target, roughness=roughness)
                seconds, error = times_and_error(rough)
                shift, half = against_cycles(rough, args.samples, args.seeds)
                figures = f"{1e3 * seconds:.1f}", f"{100 * error:.3f}", f"{100 * shift:+.2f}", f"{100 * half:.2f}"
                rows.append((name, f"{roughness:g}", *figures))
                print(*rows[-1], flush=True)
    print(results.write(args.output, "gloss", RESULTS["gloss"], rows))


if __name__ == "__main__":
    main()
