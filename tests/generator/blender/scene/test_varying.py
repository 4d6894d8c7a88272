"""What varies in an open scene: set to the value, whatever was set before, and refused by name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from generator.blender import bulk_worker
from generator.blender.scene import blend_file, build, roles
from generator.blender.scene.description import read_scene
from generator.blender.scene.varying import Varying
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.variation import parse

ROOM = preset("room")
VALUES = (("target.albedo", 0.4), ("wall.albedo", 0.7), ("room.albedo", 0.25), ("spot.power", 321.0))
VARY = [f"{name}={low}" for (name, _), low in zip(VALUES, ("0.3:1", "0.4:0.9", "0.2:0.8", "1:500"), strict=True)]


def test_values_are_set_and_nothing_else():
    scene = build.new_scene(ROOM)
    before = read_scene(scene)
    varying = Varying(scene, parse(VARY))
    assert read_scene(scene) == before
    varying.apply(tuple((name, 0.9) for name, _ in VALUES))
    varying.apply(VALUES)
    wanted = replace(
        before,
        target=replace(before.target, albedo=0.4),
        wall=replace(before.wall, albedo=0.7),
        room=replace(before.room, albedo=0.25),
        spot=replace(before.spot, power=321.0),
    )
    assert read_scene(scene) == wanted


def test_a_colour_keeps_its_hue_and_none_reflects_more_than_it_gets():
    scene = build.new_scene(ROOM)
    colour = roles.find(scene, "target").data.materials[0].node_tree.nodes["Diffuse BSDF"].inputs["Color"]
    colour.default_value = (0.9, 0.6, 0.3, 1.0)
    with pytest.raises(NlosError, match=r"up to 1, since 'Target' would then reflect 1\.5 of one colour"):
        Varying(scene, parse(["target.albedo=0.3:1"]))
    varying = Varying(scene, parse(["target.albedo=0.1:0.6"]))
    varying.apply((("target.albedo", 0.2),))
    material = roles.find(scene, "target").material_slots[0].material
    assert tuple(material.node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value)[:3] == pytest.approx(
        (0.3, 0.2, 0.1)
    )


@pytest.mark.parametrize(
    ("scene", "vary", "words"),
    [
        (replace(ROOM, wall=replace(ROOM.wall, albedo=0.0)), "wall.albedo=0.3:1", "since 'Relay wall' is black"),
        (replace(ROOM, spot=replace(ROOM.spot, power=0.0)), "spot.power=1:2", "the spot 'Spot' gives no light"),
        (replace(ROOM, room=None), "room.albedo=0.3:1", "the scene has no room surface"),
    ],
)
def test_what_cannot_vary_is_refused_by_name(scene, vary, words):
    with pytest.raises(NlosError, match=words):
        Varying(build.new_scene(scene), parse([vary]))


def test_a_bulk_set_refuses_what_is_not_proportional(tmp_path):
    def plan(scene, vary):
        chosen = {"pictures": 9, "vary": [vary], "resolution": [8, 8]}
        blend_file.save_file(tmp_path / "scene.blend")
        bulk_worker.plan(scene, tmp_path / "scene.blend", tmp_path / "set", chosen, probe=False)

    with pytest.raises(NlosError, match=r"cannot honour that target\.albedo varies under ambient light"):
        plan(build.new_scene(ROOM.with_ambient(0.1)), "target.albedo=0.3:1")
    scene = build.new_scene(replace(ROOM, partition=replace(ROOM.partition, albedo=0.5)))
    with pytest.raises(NlosError, match="and that of 'Partition', which is no surface"):
        plan(scene, "room.albedo=0.3:0.8")
    assert not (tmp_path / "set").exists()
