"""How faint is the signal? Prints the light that the target adds in each voxel, and the part that it hides again.

The target stands in the middle of each voxel, unturned. Printed are the mean of the difference picture in the closed
room; the same without the room's surfaces (the light that the target adds); the part that it removes again, because
it hides surfaces of the room from w1 or from the watched wall; and the noise of one pixel at the given samples,
unpaired and paired. Each mean has its 95 % interval over independent renders. ``-o DIR`` writes the table there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import results

from generator.blender.engines import renderers
from generator.blender.scene import blend_file, build, posing
from generator.files.toml import from_dict, to_dict
from generator.model.presets import preset
from generator.model.scene import Scene

RESULTS = {
    "signal-by-voxel": (
        "voxel",
        "difference picture",
        "added by the target",
        "hidden by it",
        "pixel noise, plain",
        "pixel noise, paired",
    )
}


def differences(scene: Scene, places: np.ndarray, samples: int, renders: int) -> tuple[np.ndarray, ...]:
    """Return paired difference pictures (places, renders, pixels), and pictures and backgrounds of the same shape."""
    blender = blend_file.new_file()
    build.build(blender, scene)
    plain, empty = [], []
    with renderers.opened(blender, "patch", resolution=scene.resolution) as renderer:
        for place in places:
            posing.move_target(blender, tuple(map(float, place)), (0.0, 0.0, 0.0))
            for pictures_of, target in ((plain, True), (empty, False)):
                pictures_of.append(
                    [renderer.render(samples=samples, seed=s, target=target)[..., 0].ravel() for s in range(renders)]
                )
    pictures, backgrounds = np.array(plain, dtype=float), np.array(empty, dtype=float)
    return pictures - backgrounds, pictures, backgrounds


def main() -> None:
    """Render and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", default="sphere", choices=["sheet", "sphere"])
    parser.add_argument("--samples", type=int, default=192)
    parser.add_argument("--renders", type=int, default=8)
    parser.add_argument("-o", "--output", type=Path, help="folder for the table as a file too")
    options = parser.parse_args()
    room = preset("room", options.target)
    bare = from_dict(Scene, {k: v for k, v in to_dict(room).items() if k != "room"})
    places = np.array([np.mean(room.grid.bounds(v), axis=0) for v in range(room.grid.n_voxels)])
    both, pictures, backgrounds = differences(room, places, options.samples, options.renders)
    added, _, _ = differences(bare, places, options.samples, options.renders)
    level = backgrounds.mean()
    print(f"{options.target}, {options.renders} renders of {options.samples} samples, 64 x 64 pixels")
    print(f"background {level:.4g} W/m^2/sr; everything below in units of 1e-3 of it")
    print("voxel   difference        added by target   hidden by it   pixel noise: plain  paired")
    table = []
    for v, label in enumerate(room.grid.labels):
        a, b = (d[v].mean(axis=1) / level * 1e3 for d in (both, added))
        (a_half, b_half) = (1.96 * x.std(ddof=1) / np.sqrt(len(x)) for x in (a, b))
        noise = [x[v].std(axis=0, ddof=1).mean() / level * 1e3 for x in (pictures, both)]
        means = [f"{a.mean():.2f} ± {a_half:.2f}", f"{b.mean():.2f} ± {b_half:.2f}"]
        hidden = f"{100.0 * (1 - a.mean() / b.mean()):.0f} %"
        table.append((label, *means, hidden, *(f"{x:.1f}" for x in noise)))
        print(f"{label:>5}   {means[0]:>14}    {means[1]:>14}    {hidden:>10}   {noise[0]:18.1f}  {noise[1]:6.1f}")
    if options.output:
        results.write(options.output, "signal-by-voxel", RESULTS["signal-by-voxel"], table)


if __name__ == "__main__":
    main()
