"""Draw the README's moving picture and the documentation's diagram of the light's path, from real results.

    python benchmarks/light_path.py -o DIR

simulates 20,000 pictures of the preset room with a hidden sphere, makes an atlas of them, moves the sphere along a
closed path, and tracks it from pictures as a camera's sensor sees them. It writes ``tracking.webp`` (moving),
``tracking.png`` (its first frame) and ``light-path.svg``. Some three minutes on two cores.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Ellipse, Rectangle
from PIL import Image

import classify
import generator
from classify.inference.tracker import Filter, Step
from generator.model.scene import Scene

LAMP, OBJECT, SEEN, ANSWER, WALL = "#E69F00", "#D55E00", "#0072B2", "#009E73", "#444444"
"""Colours from Okabe and Ito's palette, which colour-blind readers can tell apart."""
FRAMES = 60
PICTURES = 20_000
PIXELS = 32
ELLIPSE = 2.448
"""Semi-axes of a 95 % ellipse, in standard deviations."""


def path_of(scene: Scene) -> np.ndarray:
    """Return the sphere's positions on a closed path through the voxels, (FRAMES, 3), metres."""
    low, high = np.array(scene.grid.lo), np.array(scene.grid.hi)
    turn = 2 * np.pi * (np.arange(FRAMES) + 20) / FRAMES
    way = np.column_stack([np.cos(turn), np.sin(turn), 0.5 * np.sin(2 * turn)])
    return (low + high) / 2 + 0.92 * way * ((high - low) / 2 - scene.target.size / 2)


def atlas_of(scene: Scene, folder: Path) -> classify.Atlas:
    """Return an atlas of simulated pictures of the scene, for ten averaged frames."""
    generator.save_scene(folder / "room.blend")
    chosen = {"pictures": PICTURES, "resolution": str(PIXELS), "accuracy": 0.01, "inside": "centre"}
    request = generator.BulkRequest(scene=folder / "room.blend", path=folder / "set", chosen=chosen, probe=False)
    return classify.build_atlas(generator.bulk(request).bulk, classify.Sensor(frames=10))


def plan(axes: Axes, scene: Scene) -> None:
    """Draw the scene from above: walls, partition, voxels, lamp and camera."""
    room, partition, grid = scene.room, scene.partition, scene.grid
    axes.plot([room.x[0], room.x[1], room.x[1], room.x[0], room.x[0]], [0, 0, room.y[1], room.y[1], 0], WALL, lw=1)
    axes.plot(room.x, [0, 0], WALL, lw=4)
    axes.plot([partition.x, partition.x], partition.y, WALL, lw=3)
    for k, name in enumerate(grid.labels):
        low, high = grid.bounds(k)
        axes.add_patch(Rectangle(low[:2], *(high - low)[:2], fill=False, ec="#bbbbbb", lw=0.8))
        axes.text(high[0] - 0.06, high[1] - 0.06, name, color="#888888", fontsize=8, va="bottom")
    axes.plot(*scene.spot.location[:2], marker="o", ms=9, color=LAMP)
    axes.text(
        scene.spot.location[0] + 0.15, scene.spot.location[1], "lamp", color=LAMP, fontsize=9, ha="right", va="center"
    )
    axes.plot(*scene.camera.location[:2], marker="s", ms=8, color=SEEN)
    axes.text(
        scene.camera.location[0] - 0.15, scene.camera.location[1], "camera", color=SEEN, fontsize=9, va="center"
    )
    axes.set(xlim=(room.x[1] + 0.05, room.x[0] - 0.05), ylim=(room.y[1] + 0.05, -0.42), aspect="equal")
    axes.axis("off")


def light(axes: Axes, scene: Scene, x: np.ndarray) -> None:
    """Draw the light's way by three reflections, and the hidden object at x."""
    w1, w2 = scene.spot.aim[:2], (float(np.mean(scene.camera.x)), 0.0)
    legs = [(scene.spot.location[:2], w1, LAMP), (w1, x[:2], LAMP), (x[:2], w2, OBJECT)]
    for start, end, colour in [*legs, (w2, scene.camera.location[:2], SEEN)]:
        axes.annotate(
            "", end, start, arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 2}
        )
    axes.plot(scene.camera.x, [0, 0], SEEN, lw=4)
    axes.add_patch(Circle(x[:2], scene.target.size / 2, fc=OBJECT, ec="none", zorder=3))
    axes.text(*x[:2], "x", color="white", ha="center", va="center", fontsize=9, zorder=4)
    axes.text(w1[0], -0.12, "w1", ha="center", fontsize=9, color=LAMP)
    axes.text(w2[0], -0.12, "w2", ha="center", fontsize=9, color=SEEN)


def answer(axes: Axes, scene: Scene, step: Step, x: np.ndarray) -> None:
    """Draw what the pictures so far say: each voxel's probability, the position and its 95 % region."""
    for k, name in enumerate(scene.grid.labels):
        low, high = scene.grid.bounds(k)
        share = float(step.voxels[k])
        axes.add_patch(Rectangle(low[:2], *(high - low)[:2], fc=ANSWER, alpha=0.75 * share, ec="none"))
        axes.add_patch(Rectangle(low[:2], *(high - low)[:2], fill=False, ec="#999999", lw=0.8))
        axes.text(high[0] - 0.06, high[1] - 0.06, name, color="#555555", fontsize=11, va="bottom")
    values, vectors = np.linalg.eigh(step.covariance[:2, :2])
    angle = np.degrees(np.arctan2(*vectors[::-1, 1]))
    width, height = 2 * ELLIPSE * np.sqrt(values[::-1])
    axes.add_patch(Ellipse(step.position[:2], width, height, angle=angle, fill=False, ec="k", lw=1.5))
    axes.plot(*step.position[:2], "k.", ms=7)
    axes.add_patch(Circle(x[:2], scene.target.size / 2, fill=False, ec=OBJECT, ls="--", lw=1.5))
    low, high = np.array(scene.grid.lo), np.array(scene.grid.hi)
    note = "dashed: where it is; ellipse: 95 % region"
    axes.text((low[0] + high[0]) / 2, high[1] + 0.03, note, ha="center", va="top", fontsize=9, color="#555555")
    axes.set(xlim=(high[0] + 0.05, low[0] - 0.05), ylim=(high[1] + 0.14, low[1] - 0.05), aspect="equal")
    axes.axis("off")


def frame(scene: Scene, x: np.ndarray, seen: np.ndarray, change: np.ndarray, top: float, step: Step) -> Image.Image:
    """Return one frame of the moving picture."""
    figure = plt.figure(figsize=(9.6, 3.7), dpi=100)
    grid = figure.add_gridspec(
        2, 3, width_ratios=[1.55, 0.72, 1.12], left=0.01, right=0.99, bottom=0.03, top=0.88, wspace=0.12, hspace=0.28
    )
    left, raw, faint, right = (
        figure.add_subplot(grid[at]) for at in (np.s_[:, 0], np.s_[0, 1], np.s_[1, 1], np.s_[:, 2])
    )
    plan(left, scene)
    light(left, scene, x)
    left.set_title("the scene, from above", fontsize=10)
    raw.imshow(seen, cmap="gray", vmin=0, vmax=top)
    raw.set_title("what the camera sees", fontsize=10, color=SEEN)
    faint.imshow(change, cmap="cividis", vmin=0.0, vmax=0.02)
    faint.set_title("minus the empty room\n(yellow: 2 % of it or more)", fontsize=10, color=SEEN)
    for axes in (raw, faint):
        axes.set(xticks=[], yticks=[])
    answer(right, scene, step, x)
    voxel = scene.grid.labels[int(step.voxels.argmax())]
    error = 100 * float(np.linalg.norm(step.position - x))
    right.set_title(
        f"the answer: {voxel}, {100 * step.voxels.max():.0f} % sure; {error:.0f} cm off", fontsize=10, color=ANSWER
    )
    data = io.BytesIO()
    figure.savefig(data, format="png")
    plt.close(figure)
    return Image.open(data).convert("RGB")


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    matplotlib.rcParams["svg.hashsalt"] = "nlos"
    scene = generator.preset("room", "sphere")
    world = generator.new_scene(scene)
    places = path_of(scene)
    pictures, background = generator.render(world, places, engine="surfel", resolution=(PIXELS, PIXELS))
    with tempfile.TemporaryDirectory() as scratch:
        atlas = atlas_of(scene, Path(scratch))
    rng = np.random.default_rng(1)
    sensor = atlas.sensor
    empty = sensor.measure(background, rng, frames=sensor.background_frames)
    filter_ = Filter(atlas, step=0.08)
    frames = []
    for turn in range(2):  # the first turn is for the tracker to settle, so that the picture closes on itself
        for x, clean in zip(places, pictures, strict=True):
            seen = sensor.measure(clean, rng)
            step = filter_.update(atlas.code(seen, empty))
            if turn:
                grey, rest = seen.mean(axis=2), empty.mean(axis=2)
                frames.append(frame(scene, x, grey, (grey - rest) / rest.max(), float(rest.max()), step))
    frames[0].save(folder / "tracking.png")
    frames[0].save(
        folder / "tracking.webp", save_all=True, append_images=frames[1:], duration=120, loop=0, quality=70, method=6
    )
    figure, axes = plt.subplots(figsize=(6.4, 4.4))
    plan(axes, scene)
    light(axes, scene, places[8])
    figure.tight_layout(pad=0.2)
    figure.savefig(folder / "light-path.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
