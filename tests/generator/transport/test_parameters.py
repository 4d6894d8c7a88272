"""Worlds with values changed, against scenes that Blender built with those values."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
import worlds

import generator
from generator.blender.engines import survey
from generator.model.errors import NlosError
from generator.transport import Transport
from generator.transport.parameters import OFFSETS, mean_albedo, with_parameters


def built(**changes):
    """The world that Blender makes of the room with some of its values changed."""
    scene = generator.preset("room", "sphere")
    for part, values in changes.items():
        new = replace(getattr(scene, part), **values) if isinstance(values, dict) else values
        scene = replace(scene, **{part: new})
    if scene.ambient:
        scene = scene.with_ambient(scene.ambient)
    return survey.surfel_world(generator.new_scene(scene), resolution=(8, 8))


def alike(one, other, name="world"):
    """Assert that all values of two worlds are equal as far as Blender's 24 bits go."""
    assert type(one) is type(other), name
    if is_dataclass(one):
        for field in fields(one):
            alike(getattr(one, field.name), getattr(other, field.name), f"{name}.{field.name}")
    elif isinstance(one, tuple):
        assert len(one) == len(other), name
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            alike(a, b, f"{name}[{k}]")
    elif one is not None:
        np.testing.assert_allclose(one, other, rtol=2e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("offsets", "changes"),
    [
        (
            {"spot.location.x": 0.05, "spot.location.y": -0.07, "spot.location.z": 0.03, "spot.power": 0.1},
            {"spot": {"location": (-0.95, 2.93, 1.73), "power": 1100.0}},
        ),
        (
            {"spot.aim.x": 0.02, "spot.aim.z": -0.03, "spot.half_angle": 0.2},
            {"spot": {"aim": (0.32, 0.0, 1.27), "half_angle": 1.59}},
        ),
        (
            {"camera.location.x": 0.1, "camera.location.z": -0.1, "camera.view.x": -0.02, "camera.view.z": 0.01},
            {"camera": {"location": (-1.0, 3.0, 1.3), "x": (-0.97, 0.03), "z": (0.81, 1.81)}},
        ),
        (
            {"wall.albedo": -0.1, "room.albedo": 0.1, "target.albedo": -0.2, "target.size": 0.1, "ambient": 0.5},
            {
                "wall": {"albedo": 0.7},
                "room": {"albedo": 0.9},
                "target": {"albedo": 0.8, "size": 0.44},
                "ambient": 3e-3,
            },
        ),
    ],
)
def test_a_changed_world_is_that_of_a_scene_built_so(offsets, changes):
    base = built(**({"ambient": 2e-3} if "ambient" in changes else {}))
    expected = built(**changes)
    got = with_parameters(base, offsets)
    if "camera.location.x" in offsets:  # the homogeneous map is known up to a factor
        got, expected = (
            replace(w, watched=replace(w.watched, to_wall=w.watched.to_wall / w.watched.to_wall[3, 2]))
            for w in (got, expected)
        )
    alike(got, expected)


def test_no_offset_changes_nothing_and_offsets_add_up():
    base = worlds.world(worlds.sheet())
    alike(with_parameters(base, dict.fromkeys(set(OFFSETS) - {"ambient", "room.albedo"}, 0.0)), base)
    steps = {"spot.aim.x": 0.01, "spot.location.y": 0.1, "camera.view.z": 0.02, "target.albedo": -0.1}
    stepwise = base
    for name, value in steps.items():
        stepwise = with_parameters(stepwise, {name: value})
    alike(with_parameters(base, steps), stepwise)


def test_a_moved_view_sees_the_same_wall():
    """Moved by two of eight pixels, the picture is the old one moved by two."""
    base = built()
    pictures = [
        Transport(w, accuracy=1e-4).background() for w in (base, with_parameters(base, {"camera.view.x": 0.25}))
    ]
    np.testing.assert_allclose(pictures[1][:, 2:], pictures[0][:, :-2], rtol=2e-3)


def test_surfaces_that_differ_keep_their_ratio_and_black_ones_stay_black():
    base = built(room={"surfaces": ("floor", "left", "right")})
    tinted = [replace(m, albedo=m.albedo * [1.0, 0.5, 0.5]) if k == 1 else m for k, m in enumerate(base.room)]
    base = replace(base, room=tuple(tinted))
    got = with_parameters(base, {"room.albedo": 0.05})
    assert mean_albedo(got.room) == pytest.approx(mean_albedo(base.room) + 0.05)
    old, new = (np.concatenate([m.albedo for m in w.room]) for w in (base, got))
    assert (new[old == 0.0] == 0.0).all()
    ratios = new[old > 0.0] / old[old > 0.0]
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("offsets", "words"),
    [
        ({"spot.ame.x": 0.1}, "did you mean spot.aim.x"),
        ({"spot.aim.x": np.nan}, "not a finite"),
        ({"wall.albedo": 0.3}, "more than all"),
        ({"wall.albedo": -0.9}, "below 0"),
        ({"target.size": -1.0}, "above -1"),
        ({"ambient": 0.1}, "no ambient light"),
        ({"spot.aim.x": 2.5}, "leave the relay wall"),
        ({"spot.location.x": 1.5, "spot.aim.x": -1.1}, "stand in the lamp's cone"),
        ({"spot.location.y": -3.1}, "behind the relay wall"),
        ({"spot.half_angle": -2.0}, "no cone"),
        ({"camera.view.z": 0.9}, "leave the relay wall"),
        ({"camera.location.y": -3.1}, "behind the relay wall"),
    ],
)
def test_what_cannot_be_is_refused(offsets, words):
    with pytest.raises(NlosError, match=words):
        with_parameters(built(), offsets)
