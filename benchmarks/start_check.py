"""Test the check at the start of a sweep: which wrong scenes does it catch, how often does it stop a right one?

python benchmarks/start_check.py wrong -o DIR --scene room   every edit of `edits.py`, by every engine
python benchmarks/start_check.py right -o DIR                scenes that are right, checked thousands of times
python benchmarks/start_check.py table -o DIR                what both have found

A scene is wrong for an engine if the engine renders it without a message, and either it should have been refused, or
a longer comparison than the check's finds that plain Cycles' picture differs from the engine's. That comparison uses
a small scene of little noise (`edits.BASE`), whichever scene the check is tried in. Each command resumes where it was
stopped.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import results

from generator.measure import agreement
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.presets import preset

ENGINES = ("path", "patch", "surfel")
RESULTS = {"start-check": ("scene", "kind", "path", "patch", "surfel", "all")}
KINDS = {
    1: "animation",
    2: "moves with the target",
    3: "viewport and render",
    4: "inside a solid",
    5: "settings of the file",
    6: "the wall's material",
    7: "nodes that do not count",
    8: "mirrors and glass",
    9: "bounces, other lamps",
    10: "the background's world",
    11: "surfaces on one another",
}
"""Names of the kinds of edits in `edits.py`; those of higher numbers have none."""
LOOK = 6.0
"""Seconds of the longer comparison."""


def built(name: str, edit: Any, folder: Path) -> Path:
    """Build a scene, edit it and save it; return the file."""
    import bpy
    import edits

    from generator.blender.scene import blend_file, build

    scene = blend_file.new_file()
    build.build(scene, edits.BASE if name == "base" else preset("room"))
    edit(scene, folder)
    bpy.context.view_layer.update()
    path = folder / "scene.blend"
    blend_file.save_file(path)
    return path


def tried(source: Path, folder: Path, engine: str, poses: int = 1) -> tuple[str, str, float]:
    """Plan a sweep with the check; return the outcome, its message, and the seconds that the check took."""
    from generator.blender import sweep_worker
    from generator.blender.scene import blend_file

    start = time.perf_counter()
    settings = {"engine": engine, "poses": poses, **({} if engine == "surfel" else {"samples": 64})}
    try:
        dataset = sweep_worker.plan(blend_file.open_file(source), source, folder / engine, settings, reference=source)
    except NlosError as error:
        words = str(error)
        kind = "stopped" if "does not render what Cycles makes of this file" in words else "refused"
        return kind, words.replace(str(folder), ""), time.perf_counter() - start
    except Exception as error:  # a traceback is not a silent fault
        return "failed", repr(error), time.perf_counter() - start
    outcome = dataset.meta["start_check"]
    return "passed", outcome["words"], outcome["seconds"]


def looked(source: Path, folder: Path, engine: str) -> bool:
    """Return whether a longer comparison finds that the engine's picture differs from plain Cycles'."""
    from generator.blender import start_check

    saved = start_check.LIMITS, start_check.PRECISE, start_check.TOLERANCES, start_check._COPIES, agreement.SURE
    start_check.LIMITS, start_check.PRECISE, start_check.TOLERANCES = (LOOK,) * 3, (1e-3, 1e-2), (0.005, 0.02)
    start_check._COPIES, agreement.SURE = 24, 5.0
    try:
        return tried(source, folder, engine)[0] == "stopped"
    finally:
        start_check.LIMITS, start_check.PRECISE, start_check.TOLERANCES, start_check._COPIES, agreement.SURE = saved


def inside(planned: Path, case: Any, source: Path) -> bool:
    """Return whether a pose is planned inside a solid: its picture is not wrong, but the target cannot be there."""
    from generator.blender.scene import blend_file
    from generator.sets.dataset import Dataset

    if case.solid is None:
        return False
    low, high = case.solid(blend_file.open_file(source))
    places = [pose.position for pose in Dataset.open(planned).poses]
    return bool(any((np.array(place) > low).all() and (np.array(place) < high).all() for place in places))


def one(task: tuple[str, str, str]) -> list[Any]:
    """Try one edit by one engine; runs in a separate process."""
    import edits

    scene, name, engine = task
    case = edits.EDITS[name]
    with tempfile.TemporaryDirectory(prefix="nlos-") as home:
        folder = Path(home)
        try:
            source = built(scene, case.edit, folder)
            kind, words, seconds = tried(source, folder, engine, 1 if scene == "base" else 100)
            expect = case.expect
            wrong = kind in ("passed", "stopped") and scene != "base"  # tried only if wrong in the base scene
            if kind in ("passed", "stopped") and scene == "base":
                # The check itself compares `path` with plain Cycles to the bit.
                seen = kind == "stopped" if engine == "path" else looked(source, folder / "longer", engine)
                wrong = seen or (kind == "passed" and (expect == "refuse" or inside(folder / engine, case, source)))
        except NlosError as error:
            kind, words, seconds, wrong = "refused", str(error), 0.0, False
        return [scene, name, case.kind, engine, case.expect, kind, int(wrong), f"{seconds:.2f}", words]


COLUMNS = ["scene", "edit", "kind", "engine", "expect", "became", "wrong", "seconds", "words"]


def wrong(options: argparse.Namespace) -> None:
    """Try every edit by every engine."""
    import edits

    file = options.output / "wrong.csv"
    finished = {(row["scene"], row["edit"], row["engine"]) for row in rows(file)}
    tasks = [
        (options.scene, name, engine)
        for name in sorted(edits.EDITS, key=lambda name: hashlib.sha256(name.encode()).digest())  # in random order
        for engine in options.engines
        if (options.scene, name, engine) not in finished
    ]
    if options.scene != "base":  # an edit that was right or refused in the small scene leaves nothing to catch
        known = {(row["edit"], row["engine"]) for row in rows(file) if row["scene"] == "base" and row["wrong"] == "1"}
        tasks = [task for task in tasks if task[1:] in known]
    run(tasks, one, file, COLUMNS, options)


def run(
    tasks: list[Any], work: Callable[[Any], list[Any]], file: Path, columns: list[str], options: argparse.Namespace
) -> None:
    """Run each task in a separate process; each adds a line to a table."""
    file.parent.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + 60.0 * options.minutes
    if not file.exists():
        file.write_text(",".join(columns) + "\n")
    # Blender adds folders with a different module bpy, which the new processes would import.
    sys.path[:] = [folder for folder in sys.path if f"bpy{os.sep}" not in folder]
    for number, task in enumerate(tasks):
        if time.monotonic() > deadline:
            print(f"{len(tasks) - number} left")
            return
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            try:
                row = pool.apply_async(work, (task,)).get(options.patience)
            except multiprocessing.TimeoutError:
                continue
        with file.open("a", newline="") as out:
            csv.writer(out, lineterminator="\n").writerow(row)
        print(*row[:-1], flush=True)


def rows(file: Path) -> list[dict[str, str]]:
    """Return the lines of a table."""
    if not file.exists():
        return []
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


# --------------------------------------------------------------------------------------------------------------------
# Scenes that are right
# --------------------------------------------------------------------------------------------------------------------

UNIT = 256
"""Samples of one picture by plain Cycles; a check adds up several."""
DRAWN = 8
"""Number of engine pictures by `patch`, each with different noise."""
BUDGETS = (6, 20, 60)
"""Pictures of `UNIT` samples that a check has time for: on a busy machine, in a short sweep, in a long one."""


def right_scenes() -> dict[str, Callable[[], Any]]:
    """Return scenes that every engine renders correctly, by name."""
    import planning

    from generator.blender.scene import blend_file, build

    def of_preset(name: str, kind: str) -> Callable[[], Any]:
        def build_preset() -> Any:
            scene = blend_file.new_file()
            build.build(scene, preset(name, kind))
            return scene

        return build_preset

    presets = {
        f"{name}, {kind}": of_preset(name, kind)
        for name in ("room", "tabletop", "corridor")
        for kind in ("sheet", "sphere")
    }
    planned = {name: planning.SCENES[name] for name in ("cluttered", "white board", "window", "mirror panel")}
    random_rooms = {f"random {seed}": (lambda seed=seed: planning.random_scene(seed)) for seed in range(6)}
    return presets | planned | random_rooms


def pool(task: tuple[str, str, Path, int]) -> list[Any]:
    """Render a pool of pictures of one scene, by an engine and by plain Cycles; simulate checks that draw from it."""
    import bpy

    from generator.blender import start_check, sweep_worker
    from generator.blender.scene import blend_file
    from generator.model import poses
    from generator.sets import links

    name, engine, home, count = task
    file = home / f"{name.replace(', ', '-').replace(' ', '-')}-{engine}.npz"
    if not file.exists():
        with tempfile.TemporaryDirectory(prefix="nlos-") as temporary:
            folder = Path(temporary)
            source = folder / "scene.blend"
            right_scenes()[name]()
            bpy.context.view_layer.update()
            blend_file.save_file(source)
            settings = {"engine": engine, "poses": 1}
            try:
                plan = sweep_worker.plan(blend_file.open_file(source), source, folder / "set", settings, probe=False)
            except NlosError as error:
                return [name, engine, 0, 0, f"{error}"[:80]]
            known = links.of_dataset({}, folder / "set")
            checked = start_check._Check(
                folder / "set" / "scene.blend",
                source,
                known,
                plan.meta,
                plan.sweep,
                plan.poses[0],
                sweep_worker.render,
            )
            widths = checked.plain().widths()
            engines: list[list[Array]] = []
            views: list[Any] = []
            for seed in range(1 if engine == "surfel" else DRAWN):
                reseeded = replace(checked, sweep=replace(checked.sweep, seed=seed))
                views, _ = reseeded._by_engine(widths)
                engines.append([view.engine for view in views])
            plain = checked.plain()
            narrow = plain.spot.data.spot_size
            drawn: list[list[Array]] = [[] for _ in views]
            for number in range(count):
                for k, view in enumerate(views):
                    plain.spot.data.spot_size = view.width or narrow
                    seed = poses.noise_seed(99, 1000 + len(views) * number + k)
                    empty = plain.render(UNIT, seed, target=False)
                    both = [plain.render(UNIT, seed) - empty] if len(view.engine) > 1 else []
                    drawn[k].append(np.array([empty, *both]) * view.dark)
            arrays = {f"plain{k}": np.array(pictures, np.float32) for k, pictures in enumerate(drawn)}
            arrays |= {f"engine{k}": np.array([e[k] for e in engines]) for k in range(len(views))}
            np.savez_compressed(file, peaks=[v.peak for v in views], tolerances=checked.tolerances, **arrays)
    return [name, engine, *simulated(file, CHECKS), ""]


CHECKS = 400
"""Simulated checks of each scene, engine and budget."""


def simulated(file: Path, checks: int) -> tuple[int, int, float]:
    """Return how many checks were simulated from a pool, how many stopped, and the largest excess of any figure."""
    from generator.blender import start_check

    data = np.load(file)
    peaks, tolerances = data["peaks"], tuple(data["tolerances"])
    plain = [data[f"plain{k}"].astype(np.float64) for k in range(len(peaks))]
    engine = [data[f"engine{k}"] for k in range(len(peaks))]
    rng = np.random.default_rng(0)
    total, stops, farthest = 0, 0, 0.0
    for budget in BUDGETS:
        for _ in range(checks):
            pick = rng.integers(len(engine[0]))
            stop, excess = check(
                [rng.choice(p, budget) for p in plain], [e[pick] for e in engine], peaks, tolerances, start_check
            )
            total, stops, farthest = total + 1, stops + stop, max(farthest, excess)
    return total, stops, round(farthest, 2)


def check(
    plain: list[Array], engine: list[Array], peaks: Array, tolerances: tuple[float, ...], startcheck: Any
) -> tuple[bool, float]:
    """Check as `startcheck` does, comparing after each round; return whether it stops and its largest excess."""
    budget = len(plain[0])
    step = max(1, round(budget / startcheck._ROUNDS))
    largest = 0.0
    for used in (1, *range(1 + step, budget + 1, step)):
        comparisons = [
            agreement.compare(p[:used].mean(axis=0), e, samples=UNIT * used, peak=peak, tolerances=tolerances)
            for p, e, peak in zip(plain, engine, peaks, strict=True)
        ]
        largest = max(largest, *(agreement.worst(figures).excess for figures in comparisons))
        if largest > agreement.SURE:
            return True, largest
        if all(f.precision < p for f, p in zip(comparisons[-1][:2], startcheck.PRECISE, strict=True)):
            break
    return False, largest


def right(options: argparse.Namespace) -> None:
    """Simulate checks of scenes that are right."""
    file = options.output / "right.csv"
    finished = {(row["scene"], row["engine"]) for row in rows(file)}
    engines = [engine for engine in options.engines if engine != "path"]  # `path` has no noise of its own
    tasks = [
        (name, engine, options.output, options.count)
        for name in sorted(right_scenes(), key=lambda name: hashlib.sha256(name.encode()).digest())
        for engine in engines
        if (name, engine) not in finished
    ]
    run(tasks, pool, file, ["scene", "engine", "checks", "stopped", "farthest", "note"], options)


def share(part: int, whole: int) -> str:
    """Return a share with its 95 % interval by Clopper and Pearson (1934)."""
    from scipy import stats

    if not whole:
        return "-"
    low = float(stats.beta.ppf(0.025, part, whole - part + 1)) if part else 0.0
    high = float(stats.beta.ppf(0.975, part + 1, whole - part)) if part < whole else 1.0
    digits = 2 if whole > 2000 else 0
    part_of, low_to, high_to = (f"{100.0 * x:.{digits}f}" for x in (part / whole, low, high))
    return f"{part} of {whole}: {part_of} % ({low_to} to {high_to})"


def table(options: argparse.Namespace) -> None:
    """Print the results as Markdown, and write the table of what was caught."""
    judged = rows(options.output / "wrong.csv")
    scenes = list(dict.fromkeys(row["scene"] for row in judged))
    base = [row for row in judged if row["scene"] == scenes[0]]
    caught_by_kind = []
    print(f"{len(base)} edits and engines: {dict(Counter(row['became'] for row in base))}\n")
    for scene in scenes:
        in_scene = [row for row in judged if row["scene"] == scene]
        bad = [row for row in in_scene if row["wrong"] == "1"]
        print(f"### {scene}\n\n| kind | path | patch | surfel | all |\n|---|---|---|---|---|")
        for kind in [*sorted({row["kind"] for row in bad}, key=int), ""]:
            cells = []
            for engine in (*ENGINES, ""):
                group = [r for r in bad if kind in ("", r["kind"]) and engine in ("", r["engine"])]
                caught = sum(r["became"] == "stopped" for r in group)
                cells.append((f"{caught} of {len(group)}" if kind else share(caught, len(group))) if group else "")
            name = f"{kind} {KINDS.get(int(kind), '')}".strip() if kind else "all"
            caught_by_kind.append((scene, name, *cells))
            print(f"| {name} | {' | '.join(cells)} |")
        for words, cases in (
            ("missed", [r for r in bad if r["became"] != "stopped"]),
            (
                "stopped, and a longer look sees nothing",
                [r for r in in_scene if r["became"] == "stopped" and r not in bad],
            ),
        ):
            print(f"\n{words}: {', '.join('{edit} ({engine})'.format(**r) for r in cases) or 'none'}")
        if seconds := [float(r["seconds"]) for r in in_scene if r["became"] == "passed"]:
            print(
                f"\nseconds of a check that passes: {np.median(seconds):.1f} (median), {max(seconds):.1f} at most\n"
            )
    results.write(options.output, "start-check", RESULTS["start-check"], caught_by_kind)
    checked = [row for row in rows(options.output / "right.csv") if int(row["checks"])]
    print("| scene | engine | checks | stopped | farthest, standard errors |\n|---|---|---|---|---|")
    for row in checked:
        print(f"| {row['scene']} | {row['engine']} | {row['checks']} | {row['stopped']} | {row['farthest']} |")
    checks, stopped = (sum(int(row[name]) for row in checked) for name in ("checks", "stopped"))
    print(f"\n{share(stopped, checks)}")


def main() -> None:
    """Run one of the three commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["wrong", "right", "table"])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--scene", choices=["base", "room"], default="base")
    parser.add_argument("--engines", nargs="*", choices=ENGINES, default=ENGINES)
    parser.add_argument("--count", type=int, default=80, help="pictures of a pool by plain Cycles")
    parser.add_argument("--minutes", type=float, default=600.0, help="to stop after")
    parser.add_argument("--patience", type=float, default=300.0, help="seconds for one of them")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    {"wrong": wrong, "right": right, "table": table}[options.what](options)


if __name__ == "__main__":
    main()
