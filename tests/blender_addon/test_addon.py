"""The extension, built to a zip and installed from it into a clean user folder by Blender's own tool."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import textwrap
import time
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from blender_addon.packaging import build

ROOT = Path(__file__).resolve().parents[2]

INSTALL = """
import sys
import bpy
import addon_utils

ZIP = sys.argv[1]
MODULE = "bl_ext.user_default.nlos_lab"
addon_utils.enable("bl_pkg", default_set=True)  # the extension manager, off in a bare bpy
bpy.ops.extensions.package_install_files(
    filepath=ZIP, repo="user_default", enable_on_install=True, overwrite=True
)
assert MODULE in bpy.context.preferences.addons
import importlib
import numpy as np

def module(name):
    return importlib.import_module(f"{MODULE}.{name}")

roles, build, description = (module(f"generator.blender.scene.{m}") for m in ("roles", "build", "description"))
grid, presets, renderers = (
    module(f"generator.{m}") for m in ("model.grid", "model.presets", "blender.engines.renderers")
)
scene = bpy.context.scene
for obj in list(scene.objects):  # the cube, lamp and camera that Blender starts with
    bpy.data.objects.remove(obj)
settings = scene.nlos

def refused(operator):
    try:
        operator()
    except RuntimeError as error:
        return str(error)
    raise AssertionError("not refused")

def pixels(name):
    image = bpy.data.images[name]
    values = np.empty(image.size[0] * image.size[1] * 4, dtype=np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[::-1, :, :3]
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("bpy", reason="the bpy wheel makes the zip", exc_type=ImportError)
    return build.build(tmp_path_factory.mktemp("dist"))


def blender(package: Path, folder: Path, script: str, *, without: str = "_") -> str:
    """Run a script in a fresh bpy whose user folder is clean and from which the repository cannot be imported.

    ``without`` names a package that cannot be either.
    """
    lacking = folder / "lacking"
    lacking.mkdir(exist_ok=True)
    (lacking / f"{without}.py").write_text("raise ImportError")
    # By the path, so that the Blenders which it starts lack it too.
    paths = {"PYTHONPATH": str(lacking), "BLENDER_USER_RESOURCES": str(folder / "user"), "HOME": str(folder)}
    environment = {**os.environ, **paths}
    done = subprocess.run(
        [sys.executable, "-c", INSTALL + textwrap.dedent(script), str(package)],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    return done.stdout


def test_zip_holds_what_is_needed_and_no_more(package: Path) -> None:
    with zipfile.ZipFile(package) as archive:
        sources = {n: archive.read(n).decode() for n in archive.namelist()}
    wanted = (
        "__init__.py",
        "generator/blender/scene/build.py",
        "generator/blender/engines/renderers.py",
        "generator/transport/world.py",
    )
    assert {"blender_manifest.toml", "generator/transport/__init__.py", *wanted} <= set(sources)
    assert {"requirements.txt", "classify/cli/__main__.py", "classify/report/templates/page.html"} <= set(sources)
    unwanted = ("tests", "__pycache__", "packaging", "batch.py", "cli/sweep.py", ".whl")
    assert not [n for n in sources if any(word in n for word in unwanted)]
    for name, text in sources.items():
        if not name.endswith(".py") or name.startswith("classify/"):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                assert "generator" not in [a.name.partition(".")[0] for a in node.names], name
            elif isinstance(node, ast.ImportFrom) and not node.level:
                assert (node.module or "").partition(".")[0] not in ("generator", "blender_addon"), name
    assert package.stat().st_size < 1_000_000, f"{package.stat().st_size} bytes"


def test_command_line_builds(package: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "blender_addon.packaging.build", "-o", str(tmp_path / "new" / "dist")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    assert Path(done.stdout.strip()).name == package.name


def test_manifest() -> None:
    manifest = tomllib.loads((ROOT / "blender_addon" / "blender_manifest.toml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert manifest["version"] == project["version"]
    assert manifest["license"] == [f"SPDX:{project['license']}"]
    assert set(manifest["permissions"]) == {"files", "network"}


def test_absolute_import_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "module.py"
    source.write_text("def f():\n    import generator.model.scene\n")
    with pytest.raises(build.BuildError, match=r"import generator\.model\.scene"):
        build._copy(source, tmp_path, Path("copy.py"))


@pytest.mark.parametrize(
    ("line", "module", "in_addon", "in_generator"),
    [
        (
            "from generator import sets",
            "sets/__init__",
            "from .generator import sets",
            "from . import sets",
        ),
        ("from generator.files import exr", "files/exr", "from .generator.files import exr", None),
        ("from generator.files.exr import read", "files/exr", "from .generator.files.exr import read", None),
        (
            "if 1:\n    from generator.files import exr",
            "files/exr",
            None,
            "if 1:\n    from .files import exr",
        ),
    ],
)
def test_imports_become_relative(
    tmp_path: Path, line: str, module: str, in_addon: str | None, in_generator: str | None
) -> None:
    source = tmp_path / "module.py"
    source.write_text(line)
    for place, wanted in (("copy.py", in_addon), ("generator/copy.py", in_generator)):
        build._copy(source, tmp_path, Path(place))
        assert Path("generator", f"{module}.py") in build._needed(source)
        if wanted:
            assert (tmp_path / place).read_text() == wanted


def test_operator_builds_what_the_api_builds(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        from dataclasses import replace
        for preset in ("room", "tabletop", "corridor"):
            for kind in ("sheet", "sphere"):
                settings.preset, settings.target_kind = preset, kind
                assert bpy.ops.nlos.build_scene() == {"FINISHED"}
                by_operator = description.read_scene(scene)
                build.build(scene, presets.preset(preset, kind))
                assert by_operator == description.read_scene(scene), (by_operator, description.read_scene(scene))
        settings.preset = "room"
        settings.light_power, settings.target_albedo, settings.target_size = 250.0, 0.3, 0.7
        settings.grid_counts, settings.grid_lo, settings.reflection_order = (2, 1, 4), (0.9, 0.5, 0.6), 5
        settings.use_ambient, settings.ambient_radiance = True, 0.125
        bpy.ops.nlos.build_scene()
        found = description.read_scene(scene)
        assert (found.spot.power, found.target.albedo, found.ambient) == (250.0, 0.3, 0.125)
        assert found.grid == grid.VoxelGrid(lo=(0.9, 0.5, 0.6), hi=(2.3, 1.9, 2.2), shape=(2, 1, 4))
        assert "ceiling" not in found.room.surfaces and found.reflection_order == 5
        assert {o["nlos_role"] for o in scene.objects} == {*roles.SINGLE_ROLES, "room", "partition"}
        assert scene.render.engine == "CYCLES" and scene.cycles.diffuse_bounces == scene.cycles.max_bounces == 4
        assert not [m for m in sys.modules if m.partition(".")[0] in ("generator", "blender_addon")]
        assert not [m for m in sys.modules if "classify" in m.split(".")]
        """,
    )


def test_edits_by_hand_are_read_and_kept(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        bpy.ops.nlos.build_scene()
        lamp, target = roles.find(scene, "spot"), roles.find(scene, "target")
        lamp.location.x -= 0.1
        lamp.data.energy, lamp.data.color = 60.0, (1.0, 0.5, 0.0)
        target.scale = (2.0, 2.0, 2.0)
        scene["nlos_grid_shape"] = (4, 5, 6)
        scene.cycles.max_bounces = 6
        scene.cycles.diffuse_bounces = 6
        bpy.context.view_layer.update()
        bpy.ops.nlos.read_scene()
        assert tuple(settings.grid_counts) == (4, 5, 6) and settings.reflection_order == 7
        assert settings.light_power == 30.0 and settings.target_size == 1.0
        before = description.read_scene(scene)
        bpy.ops.nlos.apply()
        assert description.read_scene(scene) == before and lamp.data.energy == 60.0
        settings.light_power, settings.light_half_angle, settings.grid_counts = 45.0, 0.05, (1, 1, 1)
        settings.reflection_order = 3
        bpy.ops.nlos.apply()
        after = description.read_scene(scene)
        assert (after.spot.power, after.grid.shape, after.reflection_order) == (45.0, (1, 1, 1), 3)
        assert abs(lamp.data.spot_size - 0.1) < 1e-6 and lamp.data.energy == 90.0
        assert after.spot.location == before.spot.location and tuple(target.scale) == (2.0, 2.0, 2.0)
        """,
    )


def test_render_fills_the_images(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        bpy.ops.nlos.build_scene()
        settings.engine, settings.samples, settings.resolution, settings.seed = "patch", 8, (16, 16), 3
        assert bpy.ops.nlos.render_wall() == {"FINISHED"}
        wall, difference = pixels("NLOS wall"), pixels("NLOS difference")
        assert wall.shape == (16, 16, 3) and np.isfinite(wall).all() and (wall > 0).all()
        assert bpy.data.images["NLOS wall"].colorspace_settings.name == "Non-Color"
        with renderers.opened(scene, "patch", resolution=(16, 16)) as renderer:
            picture = renderer.render(samples=8, seed=3)
            background = renderer.render(samples=8, seed=3, target=False)
        assert np.array_equal(wall, picture) and np.array_equal(difference, picture - background)
        shown = pixels("NLOS preview")
        assert difference.any() and 0.3 < shown.max() <= 1.0 and shown.min() == 0.0

        # A second size takes the place of the first, and the picture is in the file.
        settings.resolution, settings.difference = (8, 8), False
        bpy.ops.nlos.render_wall()
        assert [i.name for i in bpy.data.images if "wall" in i.name] == ["NLOS wall"]
        wall = pixels("NLOS wall")
        assert wall.shape == (8, 8, 3) and (wall > 0).all()
        bpy.ops.wm.save_as_mainfile(filepath="saved.blend")
        bpy.ops.wm.open_mainfile(filepath="saved.blend")
        assert np.array_equal(pixels("NLOS wall"), wall)
        assert bpy.context.scene.nlos.samples == 8
        """,
    )


def test_the_device_is_that_of_the_preferences_or_of_the_panel(package: Path, tmp_path: Path) -> None:
    """No test needs a GPU: the preferences choose one that no machine has."""
    blender(
        package,
        tmp_path,
        """
        draft = module("draft")
        bpy.ops.nlos.build_scene()
        settings.engine, settings.samples, settings.resolution = "patch", 4, (8, 8)
        assert settings.device == "preferences" and draft.device_of(settings) == "cpu"
        assert "device" not in draft.sweep_of(settings)
        bpy.ops.nlos.render_wall()
        as_preferred = pixels("NLOS wall")
        settings.device = "cpu"
        bpy.ops.nlos.render_wall()
        assert np.array_equal(pixels("NLOS wall"), as_preferred)

        preferences = bpy.context.preferences.addons["cycles"].preferences
        preferences.compute_device_type = "CUDA"
        gone = preferences.devices.add()
        gone.id, gone.name, gone.type, gone.use = "CUDA_gone", "Gone", "CUDA", True
        settings.device = "preferences"
        assert draft.sweep_of(settings)["device"] == "gpu"
        told = refused(bpy.ops.nlos.render_wall)
        assert "device gpu: Cycles finds none of the GPUs that the preferences choose (CUDA)" in told, told
        settings.dataset, settings.poses = bpy.app.tempdir + "set", 1
        bpy.ops.nlos.sweep_start()
        job = module("operators.dataset").job
        job._task.settle()
        assert "none of the GPUs that the preferences choose (CUDA)" in job.words, job.words
        gone.use = False
        assert draft.device_of(settings) == "cpu"
        settings.device, settings.quality = "gpu", "time"
        assert draft.sweep_of(settings)["device"] == "gpu"
        settings.engine = "surfel"
        assert "device" not in draft.sweep_of(settings), "which would be refused, as it means nothing to it"
        """,
    )


def test_render_by_the_integral_without_numba_as_blender_has_none(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        settings.preset = "tabletop"
        bpy.ops.nlos.build_scene()
        settings.engine, settings.samples, settings.resolution = "patch", 1024, (16, 16)
        bpy.ops.nlos.render_wall()
        patch = pixels("NLOS difference")
        settings.engine = "auto"
        assert bpy.ops.nlos.render_wall() == {"FINISHED"}
        auto = pixels("NLOS difference")
        settings.engine, settings.accuracy = "surfel", 1e-3
        bpy.ops.nlos.render_wall()
        integral = pixels("NLOS difference")
        assert abs(patch.mean() / integral.mean() - 1.0) < 0.05
        level = np.sqrt((integral**2).mean())
        assert 0.0 < np.sqrt(((auto - integral) ** 2).mean()) < 0.011 * level
        """,
        without="numba",
    )


def test_the_panels_know_what_is_not_in_the_scene_and_what_build_would_discard(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        differs = module("view.differs")

        def found():
            bpy.context.view_layer.update()
            differs.read()
            return differs.found()

        assert found() == ([], []) and not differs.edited(scene)
        for preset in ("corridor", "tabletop", "room"):
            settings.preset = preset
            bpy.ops.nlos.build_scene()
            assert found() == ([], []) and not differs.edited(scene), (preset, found())
        settings.light_power *= 2.0
        settings.reflection_order = 5
        assert found() == (["light_power", "reflection_order"], [])
        bpy.ops.nlos.apply()
        assert found() == ([], []) and not differs.edited(scene)
        settings.target_kind, settings.target_size, settings.use_ambient = "sphere", 0.21, True
        assert {"target_kind", "target_size", "use_ambient"} <= set(found()[1]) and not found()[0], found()
        bpy.ops.nlos.read_scene()
        assert found() == ([], []), found()
        wall = next(o for o in scene.objects if o.get("nlos_role") == "room")
        wall.location.z += 0.01
        bpy.context.view_layer.update()
        assert differs.edited(scene)
        settings.light_power = 3.0
        bpy.ops.nlos.apply()
        assert differs.edited(scene), "what Apply writes is no edit by hand, but that still is one"
        bpy.ops.nlos.build_scene()
        assert not differs.edited(scene)

        # Reading is no change of its own, or it would follow itself for ever; a move before it is one.
        live = module("view.live")
        bpy.context.window_manager.nlos.look = True
        found()
        for moved in (False, True, False):
            if moved:
                roles.find(scene, "target").location.x += 0.1
            before, noted = differs._changes, live._look.last_change
            found()
            bpy.context.view_layer.update()
            assert (differs._changes > before) == (live._look.last_change > noted) == moved
        bpy.context.window_manager.nlos.look = False

        # A result is stale once the scene has moved on, and not any more when it is as it was.
        target = roles.find(scene, "target")
        assert not differs.is_stale("check")
        differs.note("check")
        for change, back in (
            (lambda: setattr(target.location, "x", 1.3), lambda: setattr(target.location, "x", place)),
            (lambda: setattr(lamp, "energy", 2.0 * power), lambda: setattr(lamp, "energy", power)),
        ):
            place, lamp = target.location.x, roles.find(scene, "spot").data
            power = lamp.energy
            for edit, stale in ((change, True), (back, False)):
                assert found() is not None and differs.is_stale("check") != stale
                edit()
                found()
                assert differs.is_stale("check") == stale
        """,
    )


LOOK = """
        import time
        live, state, images = (module(name) for name in ("view.live", "session.state", "view.images"))
        session = bpy.context.window_manager.nlos

        def drawn(seconds=60.0):
            # The timers, which only a window has, by hand.
            bpy.context.view_layer.update()
            live._noted(scene, bpy.context.evaluated_depsgraph_get())
            end = time.monotonic() + seconds
            while live._ask() is not None or live.waits() or not live._look.at:
                live._show()
                assert time.monotonic() < end, live.words()
                if live._look.resident.ended:
                    return None
                time.sleep(0.005)
            return None if images.shown is None else images.shown.colours

        bpy.ops.nlos.build_scene()
        settings.look_resolution = "32"
        target = roles.find(scene, "target")
"""


@pytest.mark.slow
def test_the_live_look_is_drawn_by_another_process(package: Path, tmp_path: Path) -> None:
    """It follows the object, takes its picture away where there is none, and leaves neither process nor file."""
    blender(
        package,
        tmp_path,
        LOOK
        + """
        survey, transport = module("generator.blender.engines.survey"), module("generator.transport")
        session.look = True
        first = drawn()
        world, _ = survey.world(scene, resolution=(32, 32))
        place, turn, _ = live._pose(scene)
        expected = transport.Transport(world, accuracy=live.ACCURACY).difference(place, turn)
        level = expected.mean(axis=2)
        top = images.captions["NLOS look"].top
        assert np.allclose(first, images.signed(level.astype(np.float32) / top), atol=1e-5)
        target.location.x += 0.1
        assert not np.array_equal(drawn(), first)
        target.location.y = 0.0
        assert drawn() is None and "relay wall" in live.words(), live.words()
        assert "NLOS look" not in images.captions
        target.location = place
        assert np.array_equal(drawn(), first)
        path, resident = live._look.world, live._look.resident
        assert path.exists()
        process = resident._worker._process
        session.look = False
        assert not path.exists() and process.wait(5.0) is not None
        """,
        without="numba",
    )


@pytest.mark.slow
def test_the_live_look_goes_without_the_python_that_cannot_draw_it(package: Path, tmp_path: Path) -> None:
    """Blender's own does it then; and where the process dies, that is said."""
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho no module named numpy >&2\nexit 3\n")
    broken.chmod(0o755)
    blender(
        package,
        tmp_path,
        LOOK
        + f"""
        for path in ({str(broken)!r}, {str(tmp_path)!r}):
            bpy.context.preferences.addons[MODULE].preferences.python = path
            session.look = True
            assert drawn().any() and "does not draw it" in live.words(), live.words()
            session.look = False
        bpy.context.preferences.addons[MODULE].preferences.python = sys.executable
        session.look = True
        assert drawn().any()
        live._look.resident._worker.kill()
        target.location.x += 0.1
        drawn()
        live._show()
        assert "has ended" in live.words() and "switch it off and on" in live.words(), live.words()
        """,
    )


LIVE_ANSWER = (
    LOOK
    + """
        import os
        live_answer = module("view.live_answer")
        preferences = bpy.context.preferences.addons[MODULE].preferences

        def begin():
            # The look is drawn by Blender's own Python: compiling in another would take most of a minute.
            preferences.python = ""
            session.look = True
            preferences.python = sys.executable
            session.live_answer = True

        def answered(seconds=60.0, *, look=True):
            # The timers by hand, until the look's picture is answered, or it is said why not.
            if look:
                drawn()
            end = time.monotonic() + seconds
            live_answer._show()
            while live_answer.waits():
                assert time.monotonic() < end, live_answer.words()
                time.sleep(0.005)
                live_answer._show()
            return dict(state.answer)

        def gone(pid):
            for _ in range(100):
                try:
                    os.kill(pid, 0)
                except ProcessLookupError:
                    return True
                time.sleep(0.05)
            return False
"""
)


@pytest.mark.slow
def test_a_model_answers_while_the_object_moves(
    package: Path, tmp_path: Path, scene_file: Path, command: Callable[..., Any]
) -> None:
    """As it answers the picture of that pose; what does not fit is said, and nothing is left running."""
    sets, table, atlas, model = (tmp_path / name for name in ("set", "set.h5", "a.atlas", "a.skops"))
    some = ("--pictures", "600", "--resolution", "32", "--rotation", "0", "0", "0", "--no-probe")
    assert command("generator", "bulk", scene_file, "-o", sets, *some, process=True).returncode == 0
    features = ("--features", "physics", "--sensor", "default")
    assert command("classify", "features", sets, "-o", table, *features).returncode == 0
    assert command("classify", "train", table, "-o", model, "--hyperparameters", "paper").returncode == 0
    assert command("classify", "atlas", sets, "-o", atlas, "--sensor", "default", "--frames", "100").returncode == 0
    blender(
        package,
        tmp_path,
        LIVE_ANSWER
        + f"""
        settings.model = {str(model)!r}
        begin()
        grid = roles.read_grid(scene)
        for path in ({str(model)!r}, {str(atlas)!r}):
            settings.model = path
            right = 0
            for voxel in range(9):
                target.location = np.mean(grid.bounds(voxel), axis=0)
                found = answered()
                assert set(found) == set("ABCDEFGHI") and abs(sum(found.values()) - 1.0) < 1e-6, live_answer.words()
                right += max(found, key=found.get) == grid.labels[voxel]
            assert right >= 6, (path, right)
            words = live_answer.words()
            assert len(words) == 1 and path.rpartition("/")[2] in words[0] and "simulated noise" in words[0], words
        assert "; at " in state.answer_words and " ± " in state.answer_words, state.answer_words
        assert max(live_answer.stalls()) < 0.05

        settings.look_shadows = False
        assert not answered() and "switch Shadows on" in live_answer.words()[-1]
        settings.look_shadows = True
        assert answered()
        target.location.y = 0.0
        assert not answered(), "without a picture there is no answer"
        target.location = np.mean(grid.bounds(4), axis=0)
        assert answered()
        scene["nlos_grid_shape"] = (3, 2, 1)
        live.changed()
        assert not answered() and "has other voxels" in live_answer.words()[-1], live_answer.words()
        scene["nlos_grid_shape"] = (3, 3, 1)
        live.changed()
        assert answered()

        pid = live_answer._live.resident._worker.pid
        session.look = False
        assert not session.live_answer and not state.answer and gone(pid) and not live.followers
        begin()
        assert answered()
        pid = live_answer._live.resident._worker.pid
        bpy.ops.wm.read_homefile(use_empty=True)
        assert not bpy.context.window_manager.nlos.live_answer and gone(pid) and not live.followers
        """,
        without="numba",
    )


@pytest.mark.slow
def test_live_answers_that_cannot_be_are_told_in_a_sentence(package: Path, tmp_path: Path) -> None:
    empty, bare = tmp_path / "empty.skops", tmp_path / "python"
    empty.write_bytes(b"")
    bare.write_text(f'#!/bin/sh\nexec {sys._base_executable} -S "$@"\n')
    bare.chmod(0o755)
    blender(
        package,
        tmp_path,
        LIVE_ANSWER
        + f"""
        def said(path, python=sys.executable):
            settings.model, preferences.python = path, python
            session.live_answer = True
            assert session.look, "it needs the look"
            answered(look=False)
            words = live_answer.words()
            session.look = False
            assert len(words) == 1 and not state.answer and live_answer.words() == [], words
            return words[0]

        assert said("").startswith("Choose a model")
        assert "is no such file" in said("/nowhere.skops")
        assert "make setup" in said({str(empty)!r}, "")
        assert "empty.skops: is not a model file" in said({str(empty)!r})
        assert "it lacks" in said({str(empty)!r}, {str(bare)!r})
        settings.model, preferences.python = {str(empty)!r}, sys.executable
        session.live_answer = True
        while live_answer._live.resident._worker is None:
            time.sleep(0.01)
        live_answer._live.resident._worker.kill()
        answered(look=False)
        assert "has ended" in live_answer.words()[0], live_answer.words()
        """,
    )


@pytest.mark.slow
def test_the_data_sets_workers_end_with_blender(package: Path, tmp_path: Path) -> None:
    """Even where it is killed: they notice that nobody listens any more."""
    script = """
        import os, signal, time
        bpy.ops.nlos.build_scene()
        settings.engine, settings.samples, settings.poses, settings.workers = "patch", 64, 100, 2
        settings.resolution = (16, 16)
        settings.dataset = os.path.join(os.getcwd(), "set")
        assert bpy.ops.nlos.sweep_start() == {"FINISHED"}
        job = importlib.import_module(f"{MODULE}.operators.dataset").job
        while job.running and job.done < 2:
            assert not job._task.done, job._task.error
            time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGKILL)
        """
    with pytest.raises(AssertionError, match=r"-9"):
        blender(package, tmp_path, script)

    def workers() -> list[str]:
        commands = [
            path.read_bytes().replace(b"\0", b" ").decode()
            for path in Path("/proc").glob("[0-9]*/cmdline")
            if path.exists()
        ]
        return [c for c in commands if "child.py" in c and str(tmp_path) in c]

    deadline = time.monotonic() + 30.0
    while workers() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not workers()
    assert list((tmp_path / "set").rglob("*.exr"))


@pytest.mark.parametrize(
    ("wish", "words"),
    [("'time'; settings.minutes = 0.4", "what the budget allows"), ("'error'; settings.error = 90", "as exact as")],
)
@pytest.mark.slow
def test_a_data_set_takes_what_a_time_or_an_error_allows(
    package: Path, tmp_path: Path, wish: str, words: str
) -> None:
    """The samples that the panel shows are not those of the set, which says what was taken."""
    blender(
        package,
        tmp_path,
        f"""
        import os, time
        bpy.ops.nlos.build_scene()
        settings.engine, settings.samples, settings.resolution, settings.poses = "patch", 65536, (8, 8), 2
        settings.quality = {wish}
        settings.dataset = os.path.join(os.getcwd(), "set")
        assert bpy.ops.nlos.sweep_start() == {{"FINISHED"}}
        job = importlib.import_module(f"{{MODULE}}.operators.dataset").job
        while not job._task.done:
            time.sleep(0.1)
        assert not job._task.error, job._task.error
        assert {words!r} in ' '.join(job.told), job.told
        made = job._task.result.dataset
        assert all(pose.done for pose in made.poses)
        assert made.sweep.samples != 65536
        """,
    )


def test_without_cycles_there_is_a_sentence(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        bpy.ops.nlos.build_scene()
        addon_utils.disable("cycles")
        for operator in (bpy.ops.nlos.build_scene, bpy.ops.nlos.read_scene, bpy.ops.nlos.render_wall):
            assert "Cycles is switched off" in refused(operator)
        bpy.ops.nlos.check()
        assert "Cycles is switched off" in importlib.import_module(f"{MODULE}.session.state").findings[0].text
        """,
    )


@pytest.mark.slow
def test_a_trained_model_answers(
    package: Path, tmp_path: Path, scene_file: Path, command: Callable[..., Any]
) -> None:
    features, pictures = tmp_path / "tiny.h5", tmp_path / "pictures"
    some = ("--engine", "patch", "--poses", "4", "--samples", "64", "--resolution", "8", "--no-probe")
    assert command("generator", "sweep", scene_file, "-o", pictures, *some).returncode == 0
    assert command("classify", "features", pictures, "-o", features).returncode == 0
    blender(
        package,
        tmp_path,
        f"""
        state = importlib.import_module(f"{{MODULE}}.session.state")
        bpy.context.preferences.addons[MODULE].preferences.python = sys.executable
        assert bpy.ops.nlos.test_environment() == {{"FINISHED"}}
        assert "It works: Python 3." in state.environment_words, state.environment_words
        assert "no picture yet" in refused(bpy.ops.nlos.answer) or not settings.model
        bpy.ops.nlos.build_scene()
        settings.engine, settings.samples, settings.resolution = "patch", 4, (8, 8)
        settings.train_set, settings.train_classifier = {str(pictures)!r}, "LDA"
        assert bpy.ops.nlos.train() == {{"FINISHED"}}
        words = module("operators.train").job.words
        assert words.startswith("Finds the right voxel in ") and "in 4 folds of 36 pictures; took" in words, words
        assert settings.model == {str(pictures) + ".skops"!r}
        bpy.ops.nlos.render_wall()
        assert bpy.ops.nlos.answer() == {{"FINISHED"}}
        assert set(state.answer) == set("ABCDEFGHI"), state.answer_words
        assert abs(sum(state.answer.values()) - 1.0) < 1e-6 and "with a probability of" in state.answer_words
        settings.model = {str(features)!r}
        bpy.ops.nlos.answer()
        assert not state.answer and "tiny.h5" in state.answer_words, state.answer_words
        """,
    )


def test_an_environment_is_made_named_renewed_and_removed(package: Path, tmp_path: Path) -> None:
    """By a shell script in place of Python and pip; `session/test_making.py` has the ways to fail."""
    python = tmp_path / "python"
    python.write_text(
        """#!/bin/sh
        case "$*" in
          *find_spec*) echo 3.11 whole;;
          *"-m venv"*) mkdir -p "$4/bin" "$4/site"; cp "$0" "$4/bin/python";;
          *sysconfig*) echo "$(dirname "$0")/../site";;
          *version_info*) echo 3.11.9;;
        esac
        """.replace("\n        ", "\n")
    )
    python.chmod(0o755)
    blender(
        package,
        tmp_path,
        f"""
        state, environment = module("session.state"), module("session.environment")
        preferences = bpy.context.preferences
        preferences.system.use_online_access = False
        assert "Allow Online Access" in refused(bpy.ops.nlos.make_environment)
        preferences.system.use_online_access = True
        sys.executable = {str(python)!r}
        folder, named = environment.own(), preferences.addons[MODULE].preferences
        assert not environment.is_made()
        for _ in range(2):
            assert bpy.ops.nlos.make_environment() == {{"FINISHED"}}
            assert named.python == str(folder / "bin/python") and environment.is_made()
            assert "Python 3.11.9 can read trained models, train" in state.environment_words
            assert (folder / "site/nlos_lab.pth").read_text().strip() == str(module("session.making").ADDON)
        assert bpy.ops.nlos.remove_environment() == {{"FINISHED"}}
        assert not named.python and not environment.is_made() and not folder.exists()
        sys.executable = "/nowhere"
        named.python = "/usr/bin/env"
        assert bpy.ops.nlos.make_environment() == {{"FINISHED"}}
        assert "/nowhere cannot be run" in state.environment_words and named.python == "/usr/bin/env"
        """,
    )


def test_training_is_told_and_its_failures_are_sentences(package: Path, tmp_path: Path) -> None:
    """By a shell script in place of the command line, which `test_a_trained_model_answers` asks."""
    python = tmp_path / "python"
    python.write_text(
        """#!/bin/sh
        echo "$*" >> """
        + f"{tmp_path}/asked"
        + """
        case "$*" in
          *" features "*few*) echo "error: few: class A has 1 samples" >&2; exit 2;;
          *" features "*) echo "7 of 18 pictures" >&2; echo '{"pictures": 18, "planned": 27}';;
          *odd*) echo '{"folds": 10}';;
          *) echo "10 of 10 folds" >&2; echo '{"accuracy": {"value": 0.5, "low": 0.4, "high": 0.625}, "folds": 10}';;
        esac
        """.replace("\n        ", "\n")
    )
    python.write_text(python.read_text().replace("\n        ", "\n"))
    python.chmod(0o755)
    for name in ("set", "few", "odd"):
        (tmp_path / name).mkdir()
    blender(
        package,
        tmp_path,
        f"""
        import pathlib
        train = module("operators.train")
        assert "Make Environment" in refused(bpy.ops.nlos.train)
        bpy.context.preferences.addons[MODULE].preferences.python = {str(python)!r}
        settings.dataset = {str(tmp_path / "nowhere")!r}
        assert "nowhere is not there" in refused(bpy.ops.nlos.train)
        settings.dataset, settings.train_features = {str(tmp_path / "set")!r}, "physics"
        told = []
        told_by = train.Job._told
        train.Job._told = lambda job, words: lambda line: (told_by(job, words)(line), told.append(job.words))
        assert bpy.ops.nlos.train() == {{"FINISHED"}}
        assert told == ["Describing the pictures: 7 of 18 pictures", "Training on all of them"], told
        assert train.job.words.startswith("Finds the right voxel in 50.0 % of pictures (95 % interval: 40.0 to 62.5)")
        assert "10 folds of 18 of 27 pictures; took" in train.job.words and not train.job.running
        assert settings.model == {str(tmp_path / "set.skops")!r}
        asked = pathlib.Path("asked").read_text()
        assert "--features physics --partial" in asked and "--classifier SVM --cross-validate" in asked
        settings.model = "kept"
        for name, words in (("few", "few: class A has 1 samples"), ("odd", "did not tell how well")):
            settings.train_set = {str(tmp_path)!r} + "/" + name
            assert bpy.ops.nlos.train() == {{"FINISHED"}}
            assert words in train.job.words and settings.model == "kept", train.job.words
        """,
    )


def test_the_pictures_of_a_set_are_shown_and_the_target_put_where_they_have_it(
    package: Path, tmp_path: Path, tiny_dataset: Path, scene_file: Path
) -> None:
    shutil.copytree(tiny_dataset, tmp_path / "set")
    blender(
        package,
        tmp_path,
        f"""
        import math, pathlib, shutil
        thumbnails, pages = module("view.thumbnails"), module("operators.browser")
        sets, differs = module("generator.sets.dataset"), module("view.differs")
        bpy.ops.wm.open_mainfile(filepath={str(scene_file)!r})
        scene, settings = bpy.context.scene, bpy.context.scene.nlos
        path = pathlib.Path("set").absolute()

        def look():
            records = [record for record, _, _ in pages.shown(thumbnails.opened())] if thumbnails.opened() else []
            for _ in range(2):  # the tables, then the pictures
                thumbnails.want(settings.dataset, records)
                thumbnails._serve()
                records = [r for r, _, _ in pages.shown(thumbnails.opened())] if thumbnails.opened() else []
            return records

        settings.dataset = str(path.parent / "nowhere")
        look()
        assert "is not a data set" in thumbnails.words(), thumbnails.words()
        assert "poll" in refused(lambda: bpy.ops.nlos.browse_place(voxel=0))
        settings.dataset = str(path)
        records = look()
        assert [r.label for r in records] == list("ABCDEFGHI") and not thumbnails.words()
        dataset = sets.Dataset.open(path)
        images = module("view.images")
        for record in records:
            icon, fault = thumbnails.thumbnail(record)
            assert not fault, fault
            shown = thumbnails._shelf.previews[record.file]
            level = (dataset.picture(record) - dataset.background()).mean(axis=2)
            values = np.array(shown.image_pixels_float).reshape(8, 8, 4)[::-1]
            assert tuple(shown.image_size) == (8, 8)
            brighter = np.abs(level) > 0.1 * images.scale(level)
            assert ((values[..., 0] > values[..., 2]) == (level > 0.0))[brighter].all() and brighter.any()

        place = records[4]
        assert bpy.ops.nlos.browse_place(voxel=4, position=0) == {{"FINISHED"}}
        target = roles.find(scene, "target")
        assert np.allclose(target.location, place.position, rtol=0, atol=1e-7)
        assert np.allclose([math.degrees(a) for a in target.rotation_euler], place.rotation, atol=1e-5)
        assert "no picture 2 of that voxel" in refused(lambda: bpy.ops.nlos.browse_place(voxel=4, position=1))
        target.constraints.new("LIMIT_LOCATION").use_max_x = True
        assert "does not go where it is put" in refused(lambda: bpy.ops.nlos.browse_place(voxel=8))
        assert np.allclose(target.location, place.position, rtol=0, atol=1e-7)
        target.constraints.clear()

        differs.read()
        assert thumbnails.others_than(differs.described()) == []
        scene["nlos_grid_shape"] = (2, 2, 1)
        roles.find(scene, "spot").data.energy *= 2.0
        differs.read()
        assert sorted(thumbnails.others_than(differs.described())) == ["grid", "spot"]

        # What comes, goes or breaks is told, each picture for itself.
        (path / "A/0000.exr").write_bytes((path / "A/0000.exr").read_bytes()[:300])
        shutil.copy(path / "B/0000.exr", path / "C/0000.exr")
        away = (path / "D/0000.exr").rename(path / "away.exr")
        thumbnails.forget()
        faults = [thumbnails.thumbnail(record)[1] for record in look()]
        assert "truncated" in faults[0] and "picture of label B" in faults[2], faults
        assert "away.exr" in thumbnails.opened().fault, thumbnails.opened().fault
        assert faults[3] == "is not rendered yet" and not any(faults[4:]), faults
        away.rename(path / "D/0000.exr")
        thumbnails._shelf.looked_at = -10.0
        faults = [thumbnails.thumbnail(record)[1] for record in look()]
        assert not faults[3] and "truncated" in faults[0], faults
        (path / "background.exr").unlink()
        thumbnails.forget()
        assert all("background.exr" in thumbnails.thumbnail(record)[1] for record in look()[4:])

        large = np.zeros((200, 130, 3), np.float32)
        large[:100] = 1.0
        small = thumbnails.coloured(large)
        assert small.shape == (50, 32, 3) and small[:25].any() and not small[25:].any()
        """,
    )


def test_a_face_of_the_voxel_grid_is_moved_and_never_passes_the_other(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        assert "poll" in refused(lambda: bpy.ops.nlos.drag_face(axis="X", side="LOW", by=0.1))
        bpy.ops.nlos.build_scene()
        before = roles.read_grid(scene)
        for axis, name in enumerate("XYZ"):
            for side, by in (("LOW", 0.1), ("HIGH", -0.2)):
                assert bpy.ops.nlos.drag_face(axis=name, side=side, by=by) == {"FINISHED"}
            found = roles.read_grid(scene)
            assert abs(found.lo[axis] - before.lo[axis] - 0.1) < 1e-6, found
            assert abs(found.hi[axis] - before.hi[axis] + 0.2) < 1e-6, found
            assert np.allclose(settings.grid_lo, found.lo) and np.allclose(settings.grid_hi, found.hi)
        assert found.shape == before.shape
        for side, by in (("LOW", 100.0), ("HIGH", -100.0)):
            bpy.ops.nlos.drag_face(axis="Y", side=side, by=by)
            found = roles.read_grid(scene)
            assert 0.0 < found.hi[1] - found.lo[1] < 0.0021, found
        assert description.read_scene(scene).grid == found
        settings.grid_counts = (2, 2, 2)  # a draft that waits for Apply stays
        bpy.ops.nlos.drag_face(axis="Y", side="HIGH", by=0.5)
        assert tuple(settings.grid_counts) == (2, 2, 2) and roles.read_grid(scene).shape == before.shape
        scene["nlos_grid_lo"] = (9.0, 9.0, 9.0)
        assert "must lie below" in refused(lambda: bpy.ops.nlos.drag_face(axis="X", side="LOW", by=0.1))
        """,
    )


def test_bad_states_are_told_in_a_sentence(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        for operator in (bpy.ops.nlos.apply, bpy.ops.nlos.read_scene, bpy.ops.nlos.render_wall):
            assert "no object is the" in refused(operator)
        bpy.ops.nlos.build_scene()
        settings.samples, settings.resolution = 1, (4, 4)
        bpy.data.objects.remove(roles.find(scene, "target"))
        message = refused(bpy.ops.nlos.render_wall)
        assert "no object is the target" in message and "Traceback" not in message, message
        assert not bpy.data.images.get("NLOS wall")
        settings.target_kind = "mesh"
        assert "choose a mesh file" in refused(bpy.ops.nlos.build_scene)
        settings.target_mesh = "//teapot.txt"
        assert "mesh file" in refused(bpy.ops.nlos.build_scene)
        settings.target_kind = "sheet"
        settings.grid_lo = settings.grid_hi
        assert "must lie below" in refused(bpy.ops.nlos.build_scene)
        assert "must lie below" in refused(bpy.ops.nlos.apply)
        settings.preset = "tabletop"
        settings.preset = "room"
        settings.resolution = (64, 32)
        assert "square" in refused(bpy.ops.nlos.build_scene)
        settings.resolution = (64, 64)
        bpy.ops.nlos.build_scene()
        bpy.context.view_layer.objects.active = roles.find(scene, "target")
        bpy.ops.object.mode_set(mode="EDIT")
        assert "Object Mode" in refused(bpy.ops.nlos.build_scene)
        """,
    )


def test_copies_keep_their_role_and_one_of_them_is_kept(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        bpy.ops.nlos.build_scene()
        state = module("session.state")
        first = roles.find(scene, "target")
        bpy.context.view_layer.objects.active = first
        first.select_set(True)
        bpy.ops.object.duplicate()
        second = bpy.context.active_object
        settings.dataset = bpy.app.tempdir + "set"
        bpy.ops.nlos.check()
        [found] = state.findings
        assert (found.fix, set(found.choices)) == ("keep", {first.name, second.name}), found
        for operator in (bpy.ops.nlos.render_wall, bpy.ops.nlos.sweep_start, bpy.ops.nlos.read_scene):
            told = refused(operator)
            assert "2 objects are the target" in told and "propert" not in told, told
        assert "choose from" in refused(lambda: bpy.ops.nlos.fix(fix="keep"))
        assert bpy.ops.nlos.fix(fix="keep", choice=second.name) == {"FINISHED"}
        assert roles.find(scene, "target") == second and "nlos_role" not in first
        assert not [f for f in state.findings if f.choices]
        assert [f for f in state.findings if f.object == first.name and "without a role" in f.text]
        first["nlos_role"] = "target"
        bpy.context.view_layer.objects.active = first
        first.select_set(True)
        bpy.ops.nlos.adopt(role="target")
        assert roles.find(scene, "target") == first
        """,
    )


def test_assets_are_written_beside_and_listed_once(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        import pathlib
        assets = module("operators.assets")
        listed = bpy.context.preferences.filepaths.asset_libraries
        before = len(listed)
        for _ in range(2):
            assert bpy.ops.nlos.add_assets() == {"FINISHED"}
            [library] = [one for one in listed if pathlib.Path(one.path) == assets.folder()]
            assert (library.name, library.import_method, len(listed)) == ("NLOS Lab", "APPEND", before + 1)
        assert assets.folder().is_relative_to(pathlib.Path("user").resolve())
        written = sorted(path.name for path in assets.folder().iterdir())
        assert written == ["blender_assets.cats.txt", "nlos_lab.blend"], written
        with bpy.data.libraries.load(str(assets.folder() / "nlos_lab.blend"), assets_only=True) as (found, wanted):
            assert f"{len(found.objects) + len(found.materials)} assets are in" in assets.words, assets.words
            wanted.objects = ["Relay wall, painted, 5 m x 2.6 m"]
        scene.collection.objects.link(wanted.objects[0])
        assert roles.find(scene, "relay_wall") == wanted.objects[0]
        (assets.folder() / "blender_assets.cats.txt").unlink()
        (assets.folder() / "blender_assets.cats.txt").mkdir()
        assert "cats.txt: cannot be written" in refused(bpy.ops.nlos.add_assets)
        """,
    )


def test_mesh_target_from_a_file(package: Path, tmp_path: Path) -> None:
    import mesh_files  # needs bpy

    (tmp_path / "wedge.obj").write_text("v 0 0 0\nv 2 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    mesh_files.stl(tmp_path / "shape.stl", 0.001, "Y")
    mesh_files.gltf(tmp_path / "shape.gltf", 1.0, "Y")
    (tmp_path / "bad.fbx").write_text("nonsense")
    blender(
        package,
        tmp_path,
        """
        settings.target_kind, settings.target_mesh, settings.target_size = "mesh", "wedge.obj", 0.5
        bpy.ops.nlos.build_scene()
        found = description.read_scene(scene).target
        assert found.kind == "mesh" and abs(found.size - 0.5) < 1e-6
        settings.target_mesh, settings.target_size = "shape.stl", 0.0
        settings.target_unit, settings.target_up = "mm", "Y"
        assert bpy.ops.nlos.build_scene() == {"FINISHED"}
        found = description.read_scene(scene).target
        assert (found.unit, found.up, round(found.size, 6)) == ("mm", "Y", 0.5)
        words = module("view.target_file").words
        assert "shape.stl: 0.3 x 0.2 x 0.5 m" in words(settings)[0][0], words(settings)
        settings.target_mesh, settings.target_unit, settings.target_up = "shape.gltf", "auto", "auto"
        before = {kind: len(getattr(bpy.data, kind)) for kind in ("objects", "materials", "images", "scenes")}
        assert bpy.ops.nlos.build_scene() == {"FINISHED"}
        assert {kind: len(getattr(bpy.data, kind)) for kind in before} == before
        assert roles.target_file(scene)["metres_per_unit"] == 1.0
        settings.target_mesh = "gone.gltf"
        assert "no such file" in refused(bpy.ops.nlos.build_scene)
        settings.target_mesh = "bad.fbx"
        assert "bad.fbx" in refused(bpy.ops.nlos.build_scene)
        assert roles.target_file(scene)["name"] == "shape.gltf"
        settings.target_mesh, settings.target_size = "shape.stl", 0.25
        bpy.ops.nlos.read_scene()
        assert (settings.target_unit, settings.target_up) == ("auto", "auto")
        """,
    )


def test_disable_enable_remove(package: Path, tmp_path: Path) -> None:
    blender(
        package,
        tmp_path,
        """
        bpy.ops.nlos.build_scene()
        bpy.ops.preferences.addon_disable(module=MODULE)
        assert not hasattr(bpy.types.Scene, "nlos") and not hasattr(bpy.types, "NLOS_PT_lab")
        assert description.read_scene(scene).preset == "room"  # the file does not depend on the extension
        bpy.ops.preferences.addon_enable(module=MODULE)
        assert bpy.ops.nlos.read_scene() == {"FINISHED"}
        import pathlib
        installed = pathlib.Path(sys.modules[MODULE].__file__).parent
        before = {p.name for p in installed.rglob("*") if "__pycache__" not in p.parts}
        assert "renderers.py" in before
        bpy.ops.extensions.package_uninstall(repo_index=[
            i for i, r in enumerate(bpy.context.preferences.extensions.repos) if r.module == "user_default"
        ][0], pkg_id="nlos_lab")
        assert not hasattr(bpy.types.Scene, "nlos") and not installed.exists()
        """,
    )


@pytest.mark.slow
def test_the_timeline_is_rendered_and_followed(
    package: Path, tmp_path: Path, scene_file: Path, command: Callable[..., Any]
) -> None:
    """The path that is drawn is that of the frames; what stands still, or moves besides, is told in a sentence."""
    sets, atlas, walk = tmp_path / "centre", tmp_path / "centre.atlas", tmp_path / "walk"
    some = ("--pictures", "900", "--resolution", "16", "--accuracy", "1e-2", "--inside", "centre", "--no-probe")
    made = command("generator", "bulk", scene_file, "-o", sets, *some, "--rotation", 0, 0, 0, process=True)
    assert made.returncode == 0, made.stderr
    assert command("classify", "atlas", sets, "-o", atlas, "--sensor", "default", "--frames", 10).returncode == 0
    blender(
        package,
        tmp_path,
        f"""
        timeline, path, dataset, state = (
            module(name) for name in ("operators.timeline", "view.path", "operators.dataset", "session.state")
        )
        bpy.context.preferences.addons[MODULE].preferences.python = sys.executable
        bpy.ops.nlos.build_scene()
        settings.engine, settings.resolution, settings.workers = "patch", (16, 16), 1
        settings.samples, settings.timeline_folder = 4, {str(walk)!r}
        scene.frame_start, scene.frame_end, scene.frame_step = 3, 11, 4
        target = roles.find(scene, "target")

        def rendered():
            assert bpy.ops.nlos.timeline_render() == {{"FINISHED"}}
            dataset.job._task._thread.join()
            dataset.job._ended(dataset.job._task)
            return dataset.job.status()

        assert "'Target' stands still from frame 3 to frame 11" in rendered()
        places = ((1.3, 1.2, 1.3), (1.7, 1.4, 1.3))
        for frame, place in zip((3, 11), places):
            target.location = place
            target.keyframe_insert("location", frame=frame)
        lamp = roles.find(scene, "spot").data
        energy = lamp.energy
        for frame, lamp.energy in ((3, energy), (11, 2.0 * energy)):
            lamp.keyframe_insert("energy", frame=frame)
        assert "energy of 'Spot' changes" in rendered(), dataset.job.status()
        lamp.animation_data_clear()
        lamp.energy = energy
        assert rendered() == "Finished: 3 of 3 pictures", dataset.job.status()
        assert "holds a data set already" in refused(bpy.ops.nlos.timeline_render)
        assert "Choose an atlas" in refused(bpy.ops.nlos.timeline_follow)
        settings.timeline_atlas, settings.timeline_folder = {str(atlas)!r}, {str(tmp_path / "elsewhere")!r}
        assert "render the timeline first" in refused(bpy.ops.nlos.timeline_follow)
        settings.timeline_folder = {str(walk)!r}
        settings.timeline_step = 0.3
        assert bpy.ops.nlos.timeline_follow() == {{"FINISHED"}}
        shown = path.shown()
        assert shown is not None, timeline.words
        assert shown.numbers == (3, 7, 11) and bpy.context.window_manager.nlos.overlay
        for index, frame in enumerate(shown.numbers):
            scene.frame_set(frame)
            assert path.current(frame) == index and path.current(frame + 1) is None
            assert np.allclose(shown.truth[index], target.matrix_world.translation, atol=1e-5)
        assert timeline.words[0].startswith("Median error ") and "of 3 frames inside" in timeline.words[0]
        # Every corner of a region is as improbable as its neighbours: chi-square with three degrees of freedom.
        covariance = np.diag([0.01, 0.04, 0.09])
        corners = path.path([1], [[0, 0, 0]], [[0, 0, 0]], [covariance]).regions.reshape(-1, 3)
        assert np.allclose(np.einsum("ni,ij,nj->n", corners, np.linalg.inv(covariance), corners), 7.815, atol=1e-2)

        settings.timeline_atlas = {str(scene_file)!r}
        bpy.ops.nlos.timeline_follow()
        assert len(timeline.words) == 1 and "room.blend: is not an atlas" in timeline.words[0], timeline.words
        bpy.ops.wm.read_homefile(use_empty=True)
        assert path.shown() is None and not path._handles and not timeline.words
        """,
    )
