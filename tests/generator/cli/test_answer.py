"""What commands print with ``--json``: one document, of documented keys, without NaN."""

from __future__ import annotations

import json
import math
import runpy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk, make_dataset, make_seen
from conftest import ROOT

from classify.cli import main as classify_cli
from generator.cli import main as generate_cli
from generator.cli.answer import Interval, keys, plain
from generator.cli.parser import verb_parsers


def test_values_become_what_json_knows():
    @dataclass
    class Some:
        path: Path
        share: Interval
        numbers: list[float]

    some = Some(
        Path("a") / "b", Interval(value=math.nan, low=0.0, high=math.inf), [np.float32(0.5), np.int64(2), math.inf]
    )
    assert json.loads(json.dumps(plain(some), allow_nan=False)) == {
        "path": "a/b",
        "share": {"value": None, "low": 0.0, "high": None},
        "numbers": [0.5, 2, None],
    }
    assert plain({"x": np.array([[1.0, math.nan]])}) == {"x": [[1.0, None]]}


def test_the_page_is_what_the_program_says():
    script = runpy.run_path(str(ROOT / "benchmarks" / "json_page.py"))
    assert script["PAGE"].read_text(encoding="utf-8") == script["page"](), "run python benchmarks/json_page.py"


def shape(value, prefix=""):
    """The keys of a document, as the page names them; those of objects that are not of fixed keys are left out."""
    found = set()
    for key, item in value.items():
        found.add(f"{prefix}{key}")
        items, mark = (item, "[]") if isinstance(item, list) else ([item], "")
        for one in items:
            if isinstance(one, dict):
                found |= shape(one, f"{prefix}{key}{mark}.")
    return found


def asked(module, capsys, verb, *arguments):
    """The document that a command prints; nothing else is on its standard output, and its keys are documented."""
    capsys.readouterr()
    assert module.main([verb, *map(str, arguments), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    rows = keys(verb_parsers(module.parser())[verb].get_default("answer"))
    loose = [key for key, kind, _ in rows if "object" in kind or "interval" in kind]
    free = tuple(f"{key}{mark}." for key in loose for mark in ("", "[]"))
    documented = {key for key, _, _ in rows}
    assert {key for key, *_ in rows if "." not in key} == set(found)
    assert all(key in documented or key.startswith(free) for key in shape(found)), verb
    return found


def test_generator(tmp_path, tiny_dataset, scene_file, capsys, command):
    shown = asked(generate_cli, capsys, "scene", "room", "--show", "--set", "spot.power=500")
    assert shown["figures"]["spot"]["power"] == 500.0
    assert shown["path"] is None
    assert asked(generate_cli, capsys, "verify", tiny_dataset)["faults"] == []
    state = asked(generate_cli, capsys, "status", tiny_dataset)
    assert (state["done"], state["seconds_left"]) == (9, None)
    assert state["runs"][0]["workers"][0]["done"] == 9
    rendered = asked(generate_cli, capsys, "sweep", scene_file, "-o", tiny_dataset)
    assert (rendered["planned"], rendered["done"], rendered["rendered"]) == (9, 9, 0)
    arguments = ("--engine", "surfel", "--poses", "1", "--resolution", "8", "--json")
    checked = json.loads(command("generator", "check", scene_file, *arguments).stdout)
    assert checked["errors"] == 0
    assert {finding["level"] for finding in checked["findings"]} <= {"good", "note", "warning"}


def test_bad_input_prints_no_document(tmp_path, capsys):
    assert generate_cli.main(["verify", str(tmp_path / "none"), "--json"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data set and its features."""
    folder = tmp_path_factory.mktemp("json")
    make_dataset(folder / "sheet", n=6)
    assert classify_cli.main(["features", str(folder / "sheet"), "-o", str(folder / "sheet.h5"), "-q"]) == 0
    return folder


def test_classifiers(folder, capsys):
    table, model = folder / "sheet.h5", folder / "m.skops"
    described = asked(classify_cli, capsys, "features", folder / "sheet", "-o", folder / "again.h5")
    assert (described["pictures"], described["set"]) == (54, "global")
    assert asked(classify_cli, capsys, "train", table, "-o", model, "--classifier", "LDA")["classifier"] == "LDA"
    picture = folder / "sheet/A/0000.exr"
    [answer] = asked(classify_cli, capsys, "predict", model, picture)["answers"]
    assert answer["picture"] == str(picture)
    assert answer["label"] == max(answer["probability"], key=answer["probability"].get)
    assert sum(answer["probability"].values()) == pytest.approx(1.0)
    few = ("--classifiers", "LDA", "--train-sizes", "27", "36")
    point, _ = asked(classify_cli, capsys, "learning-curve", table, "-o", folder / "l", *few)["points"]
    assert point["train_size"] == 27
    assert point["accuracy"]["low"] <= point["accuracy"]["value"] <= point["accuracy"]["high"]
    quick = ("--folds", "2", "--hyperparameters", "paper")
    results = asked(classify_cli, capsys, "compare", table, "-o", folder / "r", *quick)["results"]
    assert len(results) == 7
    assert sum(map(sum, results[0]["confusion"])) == 54


def test_what_an_atlas_answers(tmp_path, capsys):
    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    simulated = make_bulk(tmp_path / "a", pictures=400, inside="centre", room=(floor,))
    others = make_bulk(tmp_path / "b", pictures=40, inside="centre", room=(floor,), seed=1)
    atlas = tmp_path / "a.atlas"
    made = asked(classify_cli, capsys, "atlas", simulated.path, "-o", atlas, "--frames", "10")
    assert (made["pictures"], made["frames"]) == (400, 10)
    bounds = asked(classify_cli, capsys, "bound", atlas, simulated.path, "--count", "20")
    assert [voxel["voxel"] for voxel in bounds["voxels"]] == list(simulated.grid.labels)
    assert bounds["pictures"] == 20
    found = asked(classify_cli, capsys, "detect", atlas, "--exposures", "1", "10", "--count", "10")
    assert found["frames"] == [1, 10]
    assert len(found["voxels"][0]["detected"]) == 2
    seen = make_seen(tmp_path / "seen", others)
    located = asked(classify_cli, capsys, "locate", atlas, seen.path)
    assert [row["voxel"] for row in located["quality"]] == [*simulated.grid.labels, "all"]
    assert located["quality"][-1]["pictures"] == len(located["answers"]) == 12
    right = sum(answer["label"] == answer["truth"] for answer in located["answers"])
    assert located["quality"][-1]["accuracy"]["value"] == pytest.approx(right / 12)
    walk = make_seen(tmp_path / "walk", others, poses=2, frames=8, pace=0.1)
    tracked = asked(classify_cli, capsys, "track", atlas, walk.path, "--gap", "3:5", "--process-noise", "0.5")
    assert [frame["there"] for frame in tracked["frames"]] == [True] * 3 + [False] * 2 + [True] * 3
    assert len(tracked["found_again"]) == 1
    assert classify_cli.main(["track", str(atlas), str(walk.path), "--gap", "8:9"]) == 2
    assert "--gap 8:9: begins after the last of the 8 frames" in capsys.readouterr().err
