"""The whole chain from an empty folder to the paper's Table 1: two scenes, two data sets, features, comparison.

`make demo` runs it small; `make results` runs it at the paper's size. Each step is a command that anyone can type,
and is printed before it runs. When run again, it resumes where it stopped.
"""

from __future__ import annotations

import argparse
import csv
import shlex
import subprocess
import sys
from pathlib import Path

import results

TARGETS = ("sheet", "sphere")
RESULTS = {
    "reproduction": (
        "features",
        "trained on",
        "tested on",
        "classifier",
        "paper, accuracy / F1",
        "paper's settings, accuracy",
        "paper's settings, F1",
        "tuned, accuracy",
        "tuned, F1",
    ),
    "confusion": ("features", "trained on", "tested on", "classifier", "settings", "truth", "predicted", "count"),
}


def run(*command: object) -> None:
    """Run one step as `python -m`, showing it as the user would type it."""
    module, *rest = map(str, command)
    name = {"generator.cli": "nlos-generate", "classify.cli": "nlos-classify"}[module]
    print(f"\n$ {shlex.join([name, *rest])}", flush=True)
    code = subprocess.run([sys.executable, "-m", module, *rest], check=False).returncode
    if code:
        sys.exit(code)


def compared(report: Path, kind: str) -> list[tuple[str, ...]]:
    """Return the columns of `RESULTS`, in percent, from the report of a set of features."""
    with (report / "results.csv").open(newline="", encoding="utf-8") as file:
        found = {(r["train"], r["test"], r["classifier"], r["settings"]): r for r in csv.DictReader(file)}
    table = []
    for train, test, name in dict.fromkeys(key[:3] for key in found):
        cells, published = [], ""
        for settings in ("paper", "tuned"):
            row = found[train, test, name, settings]
            for value in ("accuracy", "f1"):
                middle, low, high = (100.0 * float(row[value + end]) for end in ("", "_low", "_high"))
                cells.append(f"{middle:.1f} ({low:.1f} to {high:.1f})")
            if row["paper_accuracy"]:
                published = f"{100.0 * float(row['paper_accuracy']):.0f} / {100.0 * float(row['paper_f1']):.0f}"
        table.append((kind, train, test, name, published, *cells))
    return table


def confused(report: Path, kind: str) -> list[tuple[str, ...]]:
    """Return the counts of all confusion matrices from the report of a set of features."""
    with (report / "confusion.csv").open(newline="", encoding="utf-8") as file:
        return [(kind, *row) for row in list(csv.reader(file))[1:]]


def main() -> None:
    """Render, describe and compare both targets."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("demo"), help="folder for everything that is made")
    parser.add_argument("--poses", type=int, default=20, help="per voxel; the paper has 100")
    parser.add_argument("--resolution", default="32")
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--sets", nargs="+", default=["global"], help="of features; the last one's table ends the output"
    )
    options = parser.parse_args()
    folder: Path = options.output
    folder.mkdir(parents=True, exist_ok=True)
    for target in TARGETS:
        scene = folder / f"{target}.blend"
        if not scene.is_file():
            run("generator.cli", "scene", "room", "--target", target, "-o", scene)
        sizes = ("--poses", options.poses, "--samples", options.samples, "--resolution", options.resolution)
        data = folder / target
        # The check against plain Cycles is made once: the scenes differ by the object only.
        probe = [] if target == TARGETS[0] else ["--no-probe"]
        run("generator.cli", "sweep", scene, "-o", data, "--engine", "patch", "--seed", options.seed, *sizes, *probe)
        run("generator.cli", "verify", data)
        for kind in options.sets:
            run("classify.cli", "features", data, "-o", folder / f"{target}-{kind}.h5", "--features", kind)
    table, counts = [], []
    for kind in options.sets:
        features = [folder / f"{target}-{kind}.h5" for target in TARGETS]
        run("classify.cli", "compare", *features, "-o", folder / f"report-{kind}")
        table += compared(folder / f"report-{kind}", kind)
        counts += confused(folder / f"report-{kind}", kind)
    results.write(folder, "reproduction", RESULTS["reproduction"], table)
    results.write(folder, "confusion", RESULTS["confusion"], counts)


if __name__ == "__main__":
    main()
