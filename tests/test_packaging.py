"""What is built, and what is said where Blender is not installed. ``make matrix`` installs and uses all of it."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import zipfile
from importlib.metadata import distributions
from pathlib import Path

import pytest
from conftest import ROOT
from matrix import builds

from blender_addon.packaging import sbom

NO_BLENDER = "import sys; sys.modules['bpy'] = None; from generator.cli.main import main; sys.exit(main())"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Path]]:
    """Everything, built in two surroundings."""
    pytest.importorskip("bpy", reason="the bpy wheel makes the zip", exc_type=ImportError)
    if not (ROOT / ".git").exists():
        pytest.skip("git tells which files belong to the project")
    both = []
    for around in (builds.HERE, builds.THERE):
        folder = tmp_path_factory.mktemp("build")
        tree = builds.copied(ROOT, folder / "tree", around)
        both.append(builds.archives(tree, folder / "made", around))
        both[-1]["extension"] = builds.extension(tree, folder / "made", around)
    return both


@pytest.mark.parametrize("kind", ["sdist", "wheel", "extension"])
def test_the_same_bytes_in_other_surroundings(made: list[dict[str, Path]], kind: str) -> None:
    assert made[0][kind].read_bytes() == made[1][kind].read_bytes()


def test_the_wheel_from_the_sdist_is_that_of_the_tree(made: list[dict[str, Path]], tmp_path: Path) -> None:
    tree = builds.unpacked(made[0]["sdist"], tmp_path / "sdist")
    again = builds.archives(tree, tmp_path / "made", builds.THERE, "wheel")
    assert again["wheel"].read_bytes() == made[0]["wheel"].read_bytes()


def test_archives_hold_what_is_needed_and_no_more(made: list[dict[str, Path]]) -> None:
    assert builds.faults(made[0], builds.tracked(ROOT)) == []
    files = zipfile.ZipFile(made[0]["wheel"]).namelist()
    assert {"classify/py.typed", "classify/report/templates/page.html", "blender_addon/blender_manifest.toml"} <= set(
        files
    )


def test_bill_matches_the_zip(made: list[dict[str, Path]]) -> None:
    with zipfile.ZipFile(made[0]["extension"]) as archive:
        bill = json.loads(archive.read(sbom.NAME))
        inside = {n: hashlib.sha256(archive.read(n)).hexdigest() for n in archive.namelist() if n != sbom.NAME}
    assert bill["metadata"]["component"]["licenses"] == [{"expression": "GPL-3.0-or-later"}]
    assert {part["name"]: part["hashes"][0]["content"] for part in bill["components"]} == inside
    assert {part["type"] for part in bill["components"]} == {"file"}, "nothing of other people's is bundled"


def test_bill_lists_a_wheel_as_the_package_that_it_is(tmp_path: Path) -> None:
    (tmp_path / "blender_manifest.toml").write_text('id = "x"\nversion = "1.0.0"\nlicense = ["SPDX:MIT"]\n')
    (tmp_path / "wheels").mkdir()
    with zipfile.ZipFile(tmp_path / "wheels" / "some_thing-2.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr("some_thing.py", "")
        told = "Metadata-Version: 2.1\nName: Some_Thing\nVersion: 2.0\nLicense: UNKNOWN\n"
        wheel.writestr("some_thing-2.0.dist-info/METADATA", f"{told}Classifier: {sbom._APPROVED}BSD License\n")
        wheel.writestr("some_thing-2.0.dist-info/RECORD", "")
    _, part = json.loads(sbom.extension(tmp_path))["components"]
    assert (part["name"], part["version"], part["purl"]) == ("some-thing", "2.0", "pkg:pypi/some-thing@2.0")
    assert part["licenses"] == [{"license": {"name": "BSD License"}}]
    assert len(part["hashes"][0]["content"]) == 64


def test_bill_of_an_environment_tells_every_licence() -> None:
    bill = sbom.environment(distributions())
    assert bill == sbom.environment(reversed(list(distributions()))), "whatever order they are found in"
    assert json.loads(bill)["metadata"]["component"]["name"] == "nlos-lab"
    told = {words[0]: words[2:] for words in map(str.split, sbom.table(bill).splitlines())}
    # Each tells it in another way.
    for name in ("embreex", "numpy", "opencv-contrib-python-headless", "openexr", "skops"):
        assert told[name] != ["not", "told"], name


@pytest.mark.parametrize("command", ["scene room -o {}/new.blend", "check {}", "sweep {} -o {}/set --poses 1"])
def test_one_sentence_without_blender(tmp_path: Path, command: str) -> None:
    scene = ROOT / "blend_scenes" / "room.blend"
    words = [word.format(scene if word == "{}" else tmp_path) for word in command.split()]
    done = subprocess.run(
        [sys.executable, "-c", NO_BLENDER, *words], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: this needs Blender's module bpy, which is not installed")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
