"""The whole chain from an empty folder to the paper's Table 1: two scenes, two data sets, features, comparison.

`make demo` runs it small; `make results` runs it at the paper's size. Each step is a command that anyone can type,
and is printed before it runs. When run again, it resumes where it stopped.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

TARGETS = ("sheet", "sphere")


def run(*command: object) -> None:
    """Run one step as `python -m`, showing it as the user would type it."""
    module, *rest = map(str, command)
    name = {"generator.cli": "nlos-generate", "classify.cli": "nlos-classify"}[module]
    print(f"\n$ {shlex.join([name, *rest])}", flush=True)
    code = subprocess.run([sys.executable, "-m", module, *rest], check=False).returncode
    if code:
        sys.exit(code)


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
            run("classify.cli", "features", data, "-o", folder / f"{target}-{kind}.h5", "--set", kind)
    for kind in options.sets:
        features = [folder / f"{target}-{kind}.h5" for target in TARGETS]
        run("classify.cli", "compare", *features, "-o", folder / f"report-{kind}")


if __name__ == "__main__":
    main()
