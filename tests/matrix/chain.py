"""What each row does: installs the wheel alone, and goes the user's way from a scene to an answer."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from places import Place

ENGINES = {"patch": ("--samples", "64"), "path": ("--samples", "256"), "surfel": ("--accuracy", "1e-3")}
SWEEP = ("--poses", "4", "--resolution", "16", "--workers", "1")
LIMIT = 1800.0
BILL = "environment.cdx.json"
"""Where the bill of what was installed lies in a row's folder."""

IMPORTED = """
import sys
import generator, classify, blender_addon
at = {module.__file__.partition("/site-packages/")[0] for module in (generator, classify, blender_addon)}
assert at == {sys.argv[1] + "/lib/python{}.{}".format(*sys.version_info)}, at
"""
BLENDER = """
import bpy
assert bpy.app.version_string.split()[0] == sys.argv[2], bpy.app.version_string
"""
NO_BLENDER = """
import importlib.util
assert importlib.util.find_spec("bpy") is None
"""
# Blender's own extension manager, which is off in a bare bpy, installs the zip.
EXTENSION = """
import sys
import bpy  # which brings the next one
import addon_utils
addon_utils.enable("bl_pkg", default_set=True)
bpy.ops.extensions.package_install_files(
    filepath=sys.argv[1], repo="user_default", enable_on_install=True, overwrite=True
)
assert "bl_ext.user_default.nlos_lab" in bpy.context.preferences.addons
for obj in list(bpy.context.scene.objects):
    bpy.data.objects.remove(obj)
assert bpy.ops.nlos.build_scene() == {"FINISHED"}
assert {"relay_wall", "spot", "camera", "target"} <= {obj.get("nlos_role") for obj in bpy.context.scene.objects}
addon_utils.disable("bl_ext.user_default.nlos_lab")
assert not hasattr(bpy.types.Scene, "nlos")
assert not {"generator", "blender_addon"} & {name.partition(".")[0] for name in sys.modules}
"""


class StepError(Exception):
    """A step did not do what it must, and what it said."""


@dataclass
class Run:
    """A row under way.

    Parameters
    ----------
    place : Place
        Where.
    log : Path
        What was run, how long it took, and what it said.
    """

    place: Place
    log: Path
    did: list[str] = field(default_factory=list)

    def path(self, name: str) -> Path:
        """Return a file or folder of the row."""
        return self.place.folder / name

    def step(self, name: str, *words: str | Path, code: int = 0, says: str = "") -> str:
        """Run a command; return what it printed.

        Raises
        ------
        StepError
            The exit code is another than ``code``, it took too long, or it did not say the one line on stderr, with
            ``says`` in it, that was due.
        """
        begun = time.monotonic()
        shown = shlex.join(self.place.inside(word) if isinstance(word, Path) else word for word in words)
        try:
            done = self.place.run(words, LIMIT)
        except subprocess.TimeoutExpired:
            raise StepError(f"{name}: not done in {LIMIT:g} s") from None
        with open(self.log, "a", encoding="utf-8") as file:
            file.write(f"$ {shown}\n{done.stdout}{done.stderr}")
            file.write(f"exit code {done.returncode}, {time.monotonic() - begun:.1f} s\n\n")
        if done.returncode != code:
            last = ((done.stderr.strip() or done.stdout.strip()).splitlines() or ["nothing said"])[-1]
            raise StepError(f"{name}: exit code {done.returncode}: {last}")
        if says and not (says in done.stderr and done.stderr.count("\n") == 1):
            raise StepError(f"{name}: said {done.stderr.strip()!r}, where one sentence with {says!r} was due")
        if not self.did or self.did[-1] != name:
            self.did.append(name)
        return done.stdout

    def tool(self, name: str, command: str, *words: str | Path, code: int = 0, says: str = "") -> str:
        """Run a command of the installed project."""
        return self.step(name, self.path(f"venv/bin/{command}"), *words, code=code, says=says)

    def script(self, name: str, text: str, *words: str | Path) -> str:
        """Run some lines of Python."""
        return self.step(name, self.path("venv/bin/python"), "-c", text, *words)


def install(run: Run, wheel: Path, wheels: Path, pins: Iterable[str], bpy: str | None) -> None:
    """Install the wheel into a clean environment, what it needs from a folder of wheels, and nothing else."""
    own = run.path("wheels")
    shutil.copytree(wheels, own, copy_function=_linked)
    shutil.copy(wheel, own)
    run.path("pins.txt").write_text("".join(f"{pin}\n" for pin in pins), encoding="utf-8")
    run.step("install", run.place.python, "-m", "venv", run.path("venv"))
    wanted = run.place.inside(own / wheel.name) + ("[bpy]" if bpy else "")
    flags: tuple[str | Path, ...] = ("--quiet", "--no-index", "--find-links", own, "-c", run.path("pins.txt"))
    run.step("install", run.path("venv/bin/python"), "-m", "pip", "install", *flags, wanted)
    run.step("install", run.path("venv/bin/python"), "-m", "pip", "check")
    run.script("install", IMPORTED + (BLENDER if bpy else NO_BLENDER), run.path("venv"), bpy or "")
    run.step("bill", run.path("venv/bin/python"), "-m", "blender_addon.packaging.sbom", "-o", run.path(BILL))


def with_blender(run: Run) -> None:
    """Go from a scene to an answer."""
    scenes = {target: run.path(f"{target}.blend") for target in ("sphere", "sheet")}
    for target, scene in scenes.items():
        run.tool("scene", "nlos-generate", "scene", "room", "--target", target, "-o", scene)
    run.tool("check", "nlos-generate", "check", scenes["sphere"], "--poses", "2", "--engine", "patch")
    for engine, quality in ENGINES.items():
        made = run.path(engine)
        run.tool(
            f"sweep by {engine}",
            "nlos-generate",
            *("sweep", scenes["sphere"], "-o", made, "--engine", engine, *quality, *SWEEP),
        )
        run.tool(f"sweep by {engine}", "nlos-generate", "verify", made)
    other = run.path("surfel-sheet")
    run.tool(
        "sweep by surfel",
        "nlos-generate",
        *("sweep", scenes["sheet"], "-o", other, "--engine", "surfel", *ENGINES["surfel"], *SWEEP),
    )
    learn(run, {name: run.path(name) for name in (*ENGINES, "surfel-sheet")})
    simulated = run.path("simulated")
    size = ("--pictures", "900", "--resolution", "16", "--accuracy", "3e-3", "--workers", "1")
    run.tool("bulk", "nlos-generate", "bulk", scenes["sphere"], "-o", simulated, *size)
    extension = run.path("extension")
    run.step("extension", run.path("venv/bin/python"), "-m", "blender_addon.packaging.build", "-o", extension)
    [package] = extension.glob("*.zip")
    run.script("extension", EXTENSION, package)


def learn(run: Run, sets: dict[str, Path]) -> None:
    """Take features of data sets, and compare classifiers on the first and on the last two."""
    features = {name: run.path(f"{name}.h5") for name in sets}
    for name, folder in sets.items():
        run.tool("features", "nlos-classify", "features", folder, "-o", features[name], "--set", "global")
    first, *_, one, two = features.values()
    quick = ("--folds", "2", "--settings", "paper")
    run.tool("compare", "nlos-classify", "compare", first, "-o", run.path("report-one"), *quick)
    run.tool("compare", "nlos-classify", "compare", one, two, "-o", run.path("report-two"), *quick)


def without_blender(run: Run, rows: dict[str, Path]) -> None:
    """Train on what other rows have rendered, and be told what is missing where something is to be rendered.

    Parameters
    ----------
    run : Run
        The row.
    rows : dict of Path
        The folder of each row that has rendered; each is copied first.
    """
    there = {}
    for name, folder in rows.items():
        there[name] = run.path(f"of-{name}")
        for part in ("patch", "surfel", "surfel-sheet", "simulated"):
            shutil.copytree(folder / part, there[name] / part)
        shutil.copy(folder / "sphere.blend", there[name])
    for name, folder in there.items():
        run.tool("verify", "nlos-generate", "verify", folder / "patch")
        table = run.path(f"{name}.h5")
        run.tool("verify", "nlos-classify", "features", folder / "patch", "-o", table, "--set", "spatial-hog")
    folder = next(iter(there.values()))
    learn(run, {part: folder / part for part in ("patch", "surfel", "surfel-sheet")})
    model = run.path("surfel.skops")
    run.tool("train", "nlos-classify", "train", run.path("surfel.h5"), "-o", model)
    run.tool("predict", "nlos-classify", "predict", model, folder / "surfel/E/0001.exr")
    atlas = run.path("room.atlas")
    run.tool("atlas", "nlos-classify", "atlas", folder / "simulated", "-o", atlas, "--frames", "10")
    run.tool("locate", "nlos-classify", "locate", atlas, folder / "surfel", "-o", run.path("answers"))
    scene = folder / "sphere.blend"
    missing = "this needs Blender's module bpy, which is not installed"
    name = "sweep refused in one sentence"
    run.tool(name, "nlos-generate", "sweep", scene, "-o", run.path("none"), "--poses", "1", code=2, says=missing)
    run.tool(name, "nlos-generate", "check", scene, code=2, says=missing)


def _linked(source: str, target: str) -> None:
    """Link a file where the two lie on one disk, and copy it else."""
    try:
        Path(target).hardlink_to(source)
    except OSError:
        shutil.copy(source, target)
