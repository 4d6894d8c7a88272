"""Writes a plan: the file that a sweep follows, a table and a figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from generator.files.toml import dump_toml
from generator.files.writing import csv_text, write_text
from generator.measure import figures
from generator.measure.scene_plan import HEADINGS, KEPT, LEFT_OUT, NEEDED, Plan, rows
from generator.sets.manifest import scene_hash
from generator.sets.plan_file import FILE, FORMAT

_TOLD = "told only"
"""What no plan can leave out: it is not in the scene, or always done."""


@figures.styled
def draw(plan: Plan, title: str) -> Figure:
    """Return a figure: a bar for each effect, and the tolerance."""
    effects = [effect for effect in plan.effects[::-1] if effect.share[2] > 0.0 and math.isfinite(effect.share[2])]
    figure, [[axis]] = figures.subplots(size=(figures.WIDTH, 1.5 + 0.32 * max(1, len(effects))))
    kinds = {NEEDED: figures.BLUE, KEPT: figures.SKY, LEFT_OUT: figures.PALE, _TOLD: figures.ORANGE}
    if effects:
        value, low, high = (np.array([100.0 * e.share[k] for e in effects]) for k in range(3))
        floor = 0.5 * min(100.0 * plan.tolerance, *value[value > 0.0], *high)
        shown = np.maximum(value, floor)
        told = [_TOLD if e.note else plan.verdict(e) for e in effects]
        axis.barh([e.name for e in effects], shown, color=[kinds[kind] for kind in told], ec=figures.GREY, lw=0.5)
        reach = [shown - np.maximum(np.minimum(low, shown), floor), np.maximum(high - shown, 0.0)]
        axis.errorbar(shown, range(len(effects)), xerr=reach, fmt="none", ecolor=figures.BLACK, capsize=2)
        axis.set_xscale("log")
        axis.set_xlim(left=floor)
        figures.plain_numbers(axis.xaxis)
    else:
        axis.text(0.5, 0.5, "nothing was measured", ha="center", transform=axis.transAxes)
        axis.set_yticks([])
    axis.axvline(100.0 * plan.tolerance, color=figures.VERMILION, lw=1.2, ls="--")
    axis.grid(axis="y", visible=False)
    axis.set_xlabel("error of a difference picture without it, %")
    handles: list[Patch | Line2D] = [Patch(fc=c, ec=figures.GREY, lw=0.5, label=kind) for kind, c in kinds.items()]
    handles.append(Line2D([], [], color=figures.VERMILION, ls="--", label="tolerance"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    figure.suptitle(title)
    return figure


def write(folder: Path, scene: Path, plan: Plan, title: str) -> list[Path]:
    """Write a plan: the file that a sweep follows, the table and the picture; return their paths."""
    document = {
        "format": FORMAT,
        "scene": scene.name,
        "scene_sha256": scene_hash(scene),
        "tolerance": plan.tolerance,
        "settings": {**plan.settings, **({"leave_out": plan.dropped} if plan.dropped else {})},
        "predicted": {"error": _numbers(plan.together.share), **plan.predicted},
        "effects": {
            name: {"error": _numbers(effect.share), "verdict": note}
            for effect, (name, _, _, note) in zip(plan.effects, rows(plan), strict=True)
        },
    }
    write_text(folder / FILE, dump_toml(document))
    write_text(folder / "plan.csv", csv_text(HEADINGS, rows(plan)))
    pictures = figures.save(folder / "plan.png", draw(plan, title))
    return [folder / FILE, folder / "plan.csv", *pictures]


def _numbers(share: Sequence[float]) -> list[float]:
    return [float(f"{s:.4g}") for s in share if math.isfinite(s)]
