"""Settings are described once: in docstrings, on the command line, in Blender's panels."""

import argparse
from dataclasses import fields

import numpy as np
import pytest

from classify.pictures.settings import FeatureSettings
from generator.cli.options import add_setting, add_sweep_options
from generator.model.described import default_of, range_of, words_for
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.scene import Camera, Partition, Room, Scene, Spot, Target, Wall
from generator.model.settings import Sweep
from generator.sets.bulk_settings import Settings

KINDS = (FeatureSettings, Sweep, Settings, Scene, Wall, Room, Partition, Spot, Camera, Target, VoxelGrid)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_docstring_describes_every_field(kind):
    parts = {"wall", "spot", "camera", "grid", "target", "room", "partition"} if kind is Scene else set()
    for one in fields(kind):
        if one.name not in parts:
            words = words_for(kind, one.name)
            assert words
            assert words[-1] not in ".;"
            assert f"\n{one.name} : " in kind.__doc__
            assert words[1:] in kind.__doc__


def test_options_say_what_the_fields_say():
    parser = argparse.ArgumentParser()
    add_sweep_options(parser, goal=True)
    shown = " ".join(parser.format_help().split())
    for name in ("poses", "samples", "accuracy", "seed", "inside"):
        default = default_of(Sweep, name)
        more = "; of path and patch too, which then take as many samples as that needs" if name == "accuracy" else ""
        assert f"{words_for(Sweep, name)}{more} (default: {default})" in shown


def test_a_flag_shows_whether_it_is_on():
    parser = argparse.ArgumentParser()
    add_setting(parser, "paired")
    add_setting(parser, "compress", Settings)
    shown = " ".join(parser.format_help().split())
    assert "(default: on)" in shown
    assert "(default: off)" in shown
    assert parser.parse_args(["--no-paired"]).paired is False
    assert parser.parse_args([]).compress is None


def test_what_may_be_chosen_follows_from_the_type():
    parser = argparse.ArgumentParser()
    add_setting(parser, "inside")
    assert parser.parse_args(["--inside", "centre"]).inside == "centre"
    with pytest.raises(SystemExit):
        parser.parse_args(["--inside", "beside"])


def test_lists_and_arrays_are_numbers_too():
    for rotation in ([15, 15, 90], (15, 15, 90), np.array([15.0, 15.0, 90.0])):
        assert tuple(Sweep(rotation=rotation).rotation) == (15, 15, 90)
    for rotation in ((), (1.0,), [1, 2, 3, 4]):
        with pytest.raises(NlosError, match="must be 3 numbers"):
            Sweep(rotation=rotation)
    with pytest.raises(NlosError, match="must be from 0 to 180"):
        Sweep(rotation=[0, 0, float("nan")])


@pytest.mark.parametrize(
    ("kind", "name"),
    [(k, f.name) for k in (Sweep, Settings) for f in fields(k) if range_of(k, f.name)[0] is not None],
)
def test_ranges_are_held(kind, name):
    low, high = range_of(kind, name)
    needed = {"pictures": 1} if kind is Settings else {}
    whole = isinstance(default_of(kind, name), tuple)
    size = len(default_of(kind, name)) if whole else 0
    for value in (low, high):
        kind(**{**needed, name: (value,) * size if whole else value})
    for value in (low - 1, 2 * high + 1):
        with pytest.raises(NlosError, match=f"{name}: .* must be from .* to"):
            kind(**{**needed, name: (value,) * size if whole else value})
