"""In Blender as it comes, whose Python has NumPy and nothing else of what the wheel asks for; and on odd machines.

Python is started where none of those packages can be imported, and neither can they in the processes that it starts.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from conftest import TINY as SHARED

from blender_addon.packaging import build
from generator.sets.dataset import Dataset

LACKING = {
    *("scipy", "numba", "embreex", "h5py", "OpenEXR", "cv2", "sklearn", "mahotas", "matplotlib", "rich"),
    *("jinja2", "skops", "joblib", "submitit", "shtab"),
}
BLOCK = f"""
import sys
class Lacking:
    def find_spec(self, name, *rest):
        if name.partition(".")[0] in {sorted(LACKING)}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Lacking())
"""
TINY = ("--poses", "1", "--samples", "4", "--resolution", "8", "--seed", "3")


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """Return what runs a script, from a folder, as Blender's own Python would."""
    folder = tmp_path_factory.mktemp("bare")
    (folder / "sitecustomize.py").write_text(BLOCK)

    def run(script, *arguments, cwd, **more):
        environment = {**os.environ, "PYTHONPATH": str(folder), "BLENDER_USER_RESOURCES": str(cwd / "user"), **more}
        result = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
            cwd=cwd,
            env=environment,
            timeout=300,
        )
        assert result.returncode == 0, result.stdout[-2000:] + result.stderr[-2000:]
        assert "Traceback" not in result.stdout + result.stderr
        return result.stdout

    return run


@pytest.fixture(scope="module")
def lit(tmp_path_factory, command):
    """A table under ambient light: in a room, NumPy alone takes two minutes for the lamp's shadows."""
    path = tmp_path_factory.mktemp("lit") / "lit.blend"
    small = ("--target", "sphere", "--set", "grid.shape=[1,1,1]", "--ambient", "0.001")
    assert command("generator", "scene", "tabletop", *small, "-o", path).returncode == 0
    return path


def batch(scene, output, *options):
    """A script that does what ``blender -b scene -P generator/batch.py -- -o OUTPUT ...`` does."""
    return f"""
        import runpy, sys, bpy
        bpy.ops.wm.open_mainfile(filepath={str(scene)!r})
        sys.argv = ["blender", "--", "-o", {str(output)!r}, *{options!r}]
        runpy.run_path({str(ROOT / "generator" / "batch.py")!r}, run_name="__main__")
        """


def test_what_is_blocked_is_what_the_wheel_asks_for(bare, tmp_path):
    """Or the tests below could pass in vain."""
    project = (ROOT / "pyproject.toml").read_text()
    names = {"opencv-contrib-python-headless": "cv2", "scikit-learn": "sklearn", "Jinja2": "jinja2"}
    wanted = ast.literal_eval(project.partition("dependencies = ")[2].partition("\n]")[0] + "]")
    asked = {line.partition(">=")[0] for line in wanted} - {"numpy"}
    assert {names.get(name, name) for name in asked} <= LACKING
    bare(
        f"""
        import subprocess, sys
        for name in {sorted(LACKING)}:
            try:
                __import__(name)
            except ImportError:
                continue
            sys.exit(f"{{name}} is there")
        child = subprocess.run([sys.executable, "-c", "import scipy"], capture_output=True)
        assert child.returncode, "a child finds what its parent does not"
        """,
        cwd=tmp_path,
    )


def test_every_module_of_the_extension_and_what_it_draws(bare, tmp_path):
    """The zip unpacked as a package, as Blender loads it: imported whole, enabled, looked at, checked, rendered."""
    package = build.build(tmp_path / "dist")
    shutil.unpack_archive(package, tmp_path / "addons" / "nlos_lab")
    said = bare(
        """
        import importlib, sys, time
        from pathlib import Path
        import bpy, numpy as np
        sys.path.insert(0, "addons")
        folder = Path("addons/nlos_lab")
        # What is there for `classify` alone runs in the Python that the extension makes.
        files = [p.relative_to(folder) for p in sorted(folder.rglob("*.py"))]
        files = [p for p in files if p.parts[0] not in ("generator", "classify") or str(p) in sys.argv]
        names = [".".join(("nlos_lab", *p.with_suffix("").parts)) for p in files]
        for name in names:
            if not name.endswith("child"):  # a script
                importlib.import_module(name.removesuffix(".__init__"))
        print(len(names), "modules")
        import nlos_lab
        bpy.ops.wm.read_factory_settings(use_empty=True)
        nlos_lab.register()
        bpy.context.preferences.addons.new().module = "nlos_lab"
        from nlos_lab.session import state
        from nlos_lab.view import live
        from nlos_lab.generator.transport import compiled
        assert not compiled.COMPILED
        def pixels(name):
            image = bpy.data.images[name]
            values = np.empty(image.size[0] * image.size[1] * 4, dtype=np.float32)
            image.pixels.foreach_get(values)
            return values.reshape(-1, 4)[:, :3]
        settings, manager = bpy.context.scene.nlos, bpy.context.window_manager
        settings.preset, settings.target_kind, settings.samples, settings.resolution = "tabletop", "sphere", 4, (8, 8)
        assert bpy.ops.nlos.build_scene() == {"FINISHED"}
        manager.nlos.look = True
        end = time.monotonic() + 120.0
        live._ask()  # reads the scene
        live._ask()
        while live.waits() and not live._look.resident.ended and time.monotonic() < end:
            live._show()
            time.sleep(0.01)
        assert live.pictures() and "ms" in live.words(), live.words()
        manager.nlos.look = False
        bpy.ops.nlos.check()
        assert state.findings and "No module" not in " ".join(f.text for f in state.findings), state.findings
        settings.use_ambient, settings.ambient_radiance, settings.engine = True, 1.0, "surfel"
        assert bpy.ops.nlos.build_scene() == {"FINISHED"}
        assert bpy.ops.nlos.render_wall() == {"FINISHED"}
        wall = pixels("NLOS wall")
        assert np.isfinite(wall).all() and 0.1 < wall.mean() < 10.0, wall.mean()
        nlos_lab.unregister()
        """,
        *build.in_blender(),
        cwd=tmp_path,
    )
    assert int(said.split(" modules")[0].split()[-1]) > 50


@pytest.mark.parametrize("engine", ["path", *(pytest.param(e, marks=pytest.mark.slow) for e in ("patch", "surfel"))])
def test_batch_makes_the_set_that_the_shell_makes(bare, tmp_path, lit, command, engine):
    """Under ambient light; `surfel` as NumPy runs it, to rounding."""
    options = TINY if engine != "surfel" else (*TINY[:2], *TINY[4:], "--accuracy", "1e-2")
    bare(batch(lit, tmp_path / "b", *options, "--engine", engine), cwd=tmp_path)
    other = command("generator", "sweep", lit, "-o", tmp_path / "s", *options, "--engine", engine, "--workers", "1")
    assert other.returncode == 0, other.stderr
    sets = [Dataset.open(tmp_path / name) for name in "bs"]
    for pictures in (
        [one.picture(one.records[0]) for one in sets],
        [one.background() for one in sets],
        [one.ambient_background() for one in sets],
    ):
        np.testing.assert_allclose(*pictures, rtol=1e-5 if engine == "surfel" else 0.0)


@pytest.mark.slow
def test_check_and_sweep_from_the_shell_without_them(bare, tmp_path, lit):
    """Nor does anything behind `check` and `sweep` need what it does not use."""
    for command, words in (("check", "A sweep takes"), ("sweep", "finished")):
        more = ("-o", str(tmp_path / "set"), *TINY, "--workers", "1") if command == "sweep" else TINY[2:6]
        said = bare(
            f"""
            import sys
            sys.path.insert(0, {str(ROOT)!r})
            from generator.cli.main import main
            code = main([{command!r}, {str(lit)!r}, *{more!r}])
            sys.exit(code if {command!r} == "sweep" else 0 if code in (0, 1) else code)
            """,
            cwd=tmp_path,
        )
        assert words in said


UNWRITABLE = """
import os, sys
from pathlib import Path
sys.path.insert(0, os.getcwd())
sys.dont_write_bytecode = True
from generator.transport import caching, compiled
assert compiled.COMPILED
import small
assert small.twice(2.0) == 4.0
print("cache:", caching.folder())
"""


@pytest.fixture
def unwritable(tmp_path):
    """An installation whose cache cannot be written, even by root: a file stands in the folder's place."""
    for name in ("", "/model", "/files", "/transport", "/transport/shadows"):
        name = f"generator{name}"
        (tmp_path / name).mkdir()
        for source in (ROOT / name).glob("*.py"):
            shutil.copy(source, tmp_path / name)
    (tmp_path / "generator/transport/__pycache__").write_text("")
    function = "@compiled.jit_released\ndef twice(x):\n    return 2.0 * x\n"
    (tmp_path / "small.py").write_text(f"from generator.transport import compiled\n\n\n{function}")

    def run(**environment):
        kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "PYTHONPATH")}
        result = subprocess.run(
            [sys.executable, "-c", UNWRITABLE],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            env={**kept, "HOME": "/dev/null/home", **environment},
        )
        assert result.returncode == 0, result.stderr
        return Path(result.stdout.partition("cache: ")[2].strip())

    return run


def test_an_installation_that_cannot_be_written_runs(unwritable, tmp_path):
    """In what NUMBA_CACHE_DIR names, in the user's cache, or in a temporary folder of one's own."""
    for name in ("named", "cache", "temporary"):
        (tmp_path / name).mkdir()
    named = unwritable(NUMBA_CACHE_DIR=str(tmp_path / "named"), TMPDIR=str(tmp_path / "temporary"))
    assert named.parent == tmp_path / "named"
    assert list(named.rglob("*.nbi")), "and is compiled once"
    own = unwritable(XDG_CACHE_HOME=str(tmp_path / "cache"), TMPDIR=str(tmp_path / "temporary"))
    assert own.parent == tmp_path / "cache" / "nlos-lab"
    lost = unwritable(NUMBA_CACHE_DIR="/dev/null/named", TMPDIR=str(tmp_path / "temporary"))
    assert lost.parent.parent == tmp_path / "temporary"
    assert lost.parent.stat().st_mode & 0o777 == 0o700


def test_compiled_code_is_not_taken_from_a_folder_that_others_can_write(unwritable, tmp_path):
    """What lies there is run: where the name is taken, each process compiles for itself."""
    (tmp_path / "temporary").mkdir()
    theirs = tmp_path / "temporary" / f"nlos-lab-{os.getuid()}"
    theirs.mkdir(mode=0o777)
    theirs.chmod(0o777)
    assert str(unwritable(TMPDIR=str(tmp_path / "temporary"))) == "None"
    theirs.rmdir()
    theirs.symlink_to(tmp_path)
    assert str(unwritable(TMPDIR=str(tmp_path / "temporary"))) == "None"
    assert not list(tmp_path.rglob("*.nbi"))


@pytest.mark.parametrize(
    "name", ["{blend_name}", *(pytest.param(n, marks=pytest.mark.slow) for n in ("a{b}c", "}{", "per%cent ### {:3}"))]
)
def test_a_temporary_folder_of_any_name(tmp_path, scene_file, command, tiny_dataset, name):
    """Blender 5 takes braces in what it renders to for variables; the pixels do not depend on them."""
    folder = tmp_path / name
    folder.mkdir()
    run = ("sweep", scene_file, "-o", folder / "set", *SHARED)
    result = subprocess.run(
        [sys.executable, "-m", "generator.cli", *map(str, run)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": f"/{folder}"},
    )
    assert result.returncode == 0, result.stderr
    one, other = (Dataset.open(path) for path in (folder / "set", tiny_dataset))
    np.testing.assert_array_equal(one.background(), other.background())
    np.testing.assert_array_equal(one.picture(one.records[0]), other.picture(other.records[0]))
    assert not list(folder.glob("nlos-*"))
