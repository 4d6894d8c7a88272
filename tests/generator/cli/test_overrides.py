"""What is named on the command line is neither overruled by a file nor ignored without a word."""

from __future__ import annotations

import json

import pytest
from classify_helpers import make_dataset

from classify.cli import main as classify_cli
from generator.cli import main as generate_cli
from generator.model.errors import NlosError
from generator.sets.dataset import Dataset
from generator.sets.manifest import SCENE
from generator.sets.resume import check_same


def figures(capsys, *arguments):
    """The figures of a scene."""
    assert generate_cli.main(["scene", *map(str, arguments), "--show", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["figures"]


def refused(module, capsys, *arguments):
    """The sentence that refuses a command."""
    assert module.main([*map(str, arguments)]) == 2
    return capsys.readouterr().err


@pytest.fixture
def config(tmp_path):
    file = tmp_path / "room.toml"
    file.write_text('preset = "room"\nambient = 0.5\n[target]\nkind = "sheet"\nsize = 0.3\nalbedo = 0.6\n')
    return file


def test_the_target_on_the_command_line_wins_over_the_file(capsys, config):
    assert figures(capsys, "room", "--config", config)["target"]["size"] == 0.3
    sphere = figures(capsys, "room", "--target", "sphere")["target"]
    found = figures(capsys, "room", "--config", config, "--target", "sphere")
    assert found["target"] == sphere, "not the sheet's size and albedo either"
    assert found["ambient"] == 0.5, "the rest of the file holds"
    assert figures(capsys, "room", "--config", config, "--target", "sheet")["target"]["size"] == 0.3, "the same kind"
    config.write_text("[target]\nalbedo = 0.6\n")
    darker = figures(capsys, "room", "--config", config, "--target", "sphere")["target"]
    assert darker == {**sphere, "albedo": 0.6}


def test_ambient_light_on_the_command_line_wins_over_the_file(capsys, config):
    assert figures(capsys, "room", "--config", config, "--ambient", "0.25")["ambient"] == 0.25
    assert figures(capsys, "room", "--config", config, "--set", "ambient=0.25")["ambient"] == 0.25


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("corridor", "--config", "CONFIG"), "has the figures of the preset 'room', and 'corridor' is asked for"),
        (("room", "--target", "sphere", "--set", "target.kind=sheet"), "say the same thing twice"),
        (("room", "--ambient", "1", "--set", "ambient=2"), "say the same thing twice"),
        (("room", "--set", "target.mesh=bunny.obj"), "target.mesh: means nothing to a sheet"),
    ],
)
def test_a_scene_that_contradicts_itself_is_refused(capsys, config, arguments, words):
    arguments = [str(config) if word == "CONFIG" else word for word in arguments]
    assert words in refused(generate_cli, capsys, "scene", *arguments, "--show")


@pytest.mark.parametrize("way", ["set", "file"])
def test_all_reflections_have_a_word(capsys, config, way):
    config.write_text('reflection_order = "all"\n')
    arguments = ("--set", "reflection_order=all") if way == "set" else ("--config", str(config))
    assert generate_cli.main(["scene", "room", *arguments, "--show"]) == 0
    assert "reflection_order = 1024" in capsys.readouterr().out
    assert "reflection_order" in refused(
        generate_cli, capsys, "scene", "room", "--set", "reflection_order=most", "--show"
    )


def test_a_fault_of_the_file_names_the_file(capsys, config):
    config.write_text("[lamp]\npower = 3\n")
    arguments = ("scene", "room", "--config", config, "--show")
    assert f"{config}: lamp: no such field" in refused(generate_cli, capsys, *arguments)
    config.write_text("ambient = 0.5\n")
    assert "error: ambiant: no such field" in refused(generate_cli, capsys, *arguments, "--set", "ambiant=1")


@pytest.mark.parametrize("flags", [("--cluster", "local"), ("--job-option", "timeout_min=5"), ("--job", "a=1")])
def test_options_of_jobs_need_jobs(tmp_path, capsys, flags):
    said = refused(generate_cli, capsys, "sweep", tmp_path / "room.blend", "-o", tmp_path / "set", *flags)
    assert "is an option of --jobs" in said
    assert not (tmp_path / "set").exists()


def test_an_experiment_in_a_scene_of_ones_own_takes_no_other_light(tmp_path, capsys):
    arguments = ("experiment", "1", "-o", tmp_path / "e", "--scene", tmp_path / "room.blend", "--ambient", "2")
    assert "--ambient: is for the presets" in refused(generate_cli, capsys, *arguments)


def test_an_accuracy_for_a_set_that_is_there_is_told_to_be_too_late(tiny_dataset, scene_file, capsys):
    arguments = ["sweep", str(scene_file), "-o", str(tiny_dataset), "--engine", "patch", "--accuracy", "1%"]
    assert generate_cli.main(arguments) == 0
    assert "goes on as it was begun; --accuracy is for new sets" in capsys.readouterr().out


def test_a_trajectory_has_no_use_for_inside(tmp_path):
    dataset = make_dataset(tmp_path / "d", n=1)
    settings = dataset.meta["sweep"]
    del settings["inside"], settings["poses"]
    settings["frames"] = 9
    (tmp_path / "d" / SCENE).write_bytes(b"")
    with pytest.raises(NlosError, match="its poses lie on a trajectory, not in voxels"):
        check_same(dataset, tmp_path / "d" / SCENE, {"inside": "centre"})


@pytest.mark.parametrize("engine", [(), ("--engine", "surfel")])
def test_check_says_which_options_mean_nothing(scene_file, command, engine):
    done = command("generator", "check", scene_file, "--poses", "1", "--samples", "8", "--resolution", "8", *engine)
    assert done.returncode == 0
    assert "warning: --samples: means nothing to the engine 'surfel'" in done.stdout


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--seed", "1"), "--seed: is of the sensor's noise; name a sensor"),
        (("--tone", "linear", "--floor", "1e-6"), "--floor: means nothing to --tone linear"),
        (("--features", "physics", "--tone", "log"), "--tone: means nothing to the features physics"),
        (("--features", "physics", "--ceiling", "1"), "--ceiling: means nothing to the features physics"),
    ],
)
def test_features_refuse_options_without_effect(tmp_path, capsys, flags, words):
    make_dataset(tmp_path / "d", n=1)
    assert words in refused(classify_cli, capsys, "features", tmp_path / "d", "-o", tmp_path / "f.h5", *flags)
    assert not (tmp_path / "f.h5").exists()


def test_a_background_for_a_model_of_raw_pictures_is_told_to_mean_nothing(tmp_path, capsys):
    make_dataset(tmp_path / "d", n=4)
    table, model, picture = tmp_path / "f.h5", tmp_path / "m.skops", tmp_path / "d" / "A" / "0000.exr"
    assert classify_cli.main(["features", str(tmp_path / "d"), "-o", str(table), "--input", "raw", "-q"]) == 0
    assert classify_cli.main(["train", str(table), "-o", str(model), "--classifier", "LDA", "-q"]) == 0
    capsys.readouterr()
    background = str(Dataset.open(tmp_path / "d").path / "background.exr")
    assert classify_cli.main(["predict", str(model), str(picture), "--background", background]) == 0
    assert "--background: means nothing to this model" in capsys.readouterr().err
