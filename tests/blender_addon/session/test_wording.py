"""Messages that reach a panel name what the panels have, not options of a shell."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("bpy", exc_type=ImportError)

from blender_addon.session.wording import shown

ROOT = Path(__file__).resolve().parents[3]
OPTION = re.compile(r"(?<![\w-])--[a-z]")
SHELL = re.compile(r"nlos-(?:generate|classify) (\w+)")

ELSEWHERE = {
    "generator/jobs/cluster.py": "a cluster's jobs",
    "generator/jobs/bulk.py": "bulk sets",
    "generator/sets/bulk_settings.py": "bulk sets",
    "generator/sets/simulated.py": "bulk sets",
    "generator/sets/unknown_objects.py": "bulk sets",
    "generator/blender/bulk_worker.py": "bulk sets",
    "generator/sets/plan_file.py": "plans",
    "generator/measure/scene_plan.py": "plans",
    "generator/measure/tradeoff.py": "trade-offs",
    "generator/files/toml.py": "--set",
    "classify/inference/atlas_build.py": "making an atlas",
    "classify/inference/two_objects.py": "atlases of two objects, which no panel asks",
    "classify/pictures/sensor.py": "sensors, which no panel sets",
    **dict.fromkeys(
        (
            f"classify/pictures/{name}.py"
            for name in ("burst", "importing", "photon_transfer", "recipe", "rectify", "sensor_file")
        ),
        "a camera's pictures, which no panel takes in",
    ),
    "generator/sets/measured.py": "sets of a camera's pictures",
    "generator/sets/description.py": "sets of a camera's pictures",
    "classify/pictures/leak.py": "a test set of its own, which no panel names",
}
"""Modules whose messages no panel can show, and what they are about."""
ELSEWHERE_SAID = (
    "--shard",  # the panels share nothing out
    "--plan",
    "--jobs",
    "--targets",
    "--sensor",
    "--no-paired",  # nothing varies
    "one with --frames",  # atlases of several frames
    "make it with --frames",
    "of an uncertain scene",
    "not known where the object stood",  # sets of a camera's pictures
    "fewer, or keep all of each",  # several objects
)
ONLY_IN_A_SHELL = {"atlas", "bulk", "verify", "sweep"}


def messages() -> Iterator[tuple[str, str]]:
    """Yield the module and the text of every message with an option or a command in it."""
    folders = ("generator", "classify/inference", "classify/classifiers", "classify/pictures")
    for file in (file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))):
        name = file.relative_to(ROOT).as_posix()
        if name.startswith("generator/cli/") or name in ELSEWHERE:
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        ours = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
        docs = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
        for node in ast.walk(tree):
            if id(node) in docs:
                continue
            if isinstance(node, ast.JoinedStr):
                text = "".join(str(p.value) if isinstance(p, ast.Constant) else "patch" for p in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in ours:
                text = node.value
            else:
                continue
            if text == "--patch":  # an argument of a process
                continue
            if OPTION.search(text) or SHELL.search(text):
                yield name, text


def test_no_message_of_the_panels_names_an_option() -> None:
    found = list(messages())
    assert len(found) > 25
    told = [(name, text, shown(text)) for name, text in found if not any(words in text for words in ELSEWHERE_SAID)]
    left = [(name, words) for name, _, words in told if OPTION.search(words)]
    assert not left, "\n".join(map(str, left))
    commands = [(name, words) for name, _, words in told if set(SHELL.findall(words)) - ONLY_IN_A_SHELL]
    assert not commands, "\n".join(map(str, commands))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "take a smaller target, or larger voxels, or smaller turns (--rotation 0 0 0), or only its centre inside "
            "(--inside centre) (a mesh's unit is the metre; target.size scales it)",
            "take a smaller target, or larger voxels, or only its centre inside (Data Set > Inside > Its Centre) (a "
            "mesh's unit is the metre; Target > Size scales it)",
        ),
        (
            "--accuracy means nothing to it",
            "Accuracy means nothing to it",
        ),
        (
            "accuracy: means nothing to the engine 'patch'; leave it out",
            "Accuracy: means nothing to the engine 'patch'",
        ),
        ("it has it; use --engine patch", "it has it; take the engine patch (Rendering > Settings)"),
        ("room.blend: target.mesh: a.obj is 3 m long", "room.blend: Target > File: a.obj is 3 m long"),
        ("/tmp/target.mesh/a--b.obj is no such file", "/tmp/target.mesh/a--b.obj is no such file"),
        ("--budget: 10 s are over before a few pictures are", "Minutes: 10 s are over before a few pictures are"),
    ],
)
def test_an_option_is_a_label(text: str, words: str) -> None:
    assert shown(text).startswith(words)
