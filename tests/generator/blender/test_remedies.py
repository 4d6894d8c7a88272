"""Whatever stands in an engine's way is named with its object and material, and with what would mend it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest
from conftest import ROOT

pytest.importorskip("bpy", exc_type=ImportError)

import bpy

from generator.blender import remedies
from generator.blender.engines import survey
from generator.blender.finding import WARNING
from generator.blender.scene import build, roles
from generator.model.presets import preset

ENGINES = ROOT / "generator" / "blender" / "engines"
FILES = ("reading", "lit_patch", "watched", "survey", "lamps", "shapes", "planes", "at_rest")
PARTS = (  # of phrases, or of errors that say themselves what would be right
    "cannot be swept",
    "cannot honour that",
    "shines too, and",
    "OpenColorIO",
    "another face of",
    "which moves with the target,",
    "around which lamps shine",
    "nor that",
)
LABEL = re.compile(
    r"a point cloud|the (relay wall|target|spot|camera|lamp|world) [12 ]+|.* lie|has a material \(12\) that"
)


def phrases() -> Iterator[str]:
    """Yield the phrases that the readers of a scene hold against an engine."""
    for name in FILES:
        tree = ast.parse((ENGINES / f"{name}.py").read_text(encoding="utf-8"))
        joined = [n for n in ast.walk(tree) if isinstance(n, ast.JoinedStr)]
        inside = {id(part) for n in joined for part in ast.walk(n) if part != n}
        docs = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
        for node in ast.walk(tree):
            if id(node) in docs or id(node) in inside:
                continue
            if isinstance(node, ast.JoinedStr):
                text = "".join(str(p.value) if isinstance(p, ast.Constant) else "12" for p in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = node.value
            else:
                continue
            if len(text.split()) > 2 and not LABEL.fullmatch(text) and not any(part in text for part in PARTS):
                yield text


def test_there_is_a_remedy_for_every_phrase() -> None:
    found = list(phrases())
    assert len(found) > 50
    assert not [text for text in found if not remedies.remedy(text)[0]]


def test_object_and_material_are_named_and_what_would_mend_it() -> None:
    scene = bpy.context.scene
    build.build(scene, preset("room"))
    target, spot = roles.find(scene, "target"), roles.find(scene, "spot")
    material = target.data.materials[0]
    material.node_tree.nodes["Diffuse BSDF"].inputs["Roughness"].default_value = 0.5
    spot.data.shadow_soft_size = 0.1
    found = {f.object: f for f in (remedies.finding(scene, WARNING, why) for why in _reasons(scene))}
    assert {target.name, spot.name} <= set(found)
    assert repr(material.name) in found[target.name].text
    assert "one Diffuse BSDF" in found[target.name].text
    assert found[spot.name].text.endswith("set the lamp's Radius to 0")


def test_a_fix_is_offered_where_there_is_one() -> None:
    scene = bpy.context.scene
    build.build(scene, preset("room"))
    nodes = roles.find(scene, "target").data.materials[0].node_tree
    glossy = nodes.nodes.new("ShaderNodeBsdfAnisotropic")
    nodes.links.new(glossy.outputs[0], nodes.nodes["Material Output"].inputs[0])
    roles.limit_reflections(scene, 4)
    found = [remedies.finding(scene, WARNING, why) for why in _reasons(scene)]
    assert "reflections" in [f.fix for f in found], found


def test_the_name_of_an_object_may_have_quotes() -> None:
    scene = bpy.context.scene
    build.build(scene, preset("room"))
    wall = roles.find(scene, "relay_wall")
    wall.name = "Anna's wall"
    assert remedies.named(scene, f"the relay wall {wall.name!r} has no surface") == wall.name


def _reasons(scene: bpy.types.Scene) -> list[str]:
    return survey.survey(scene).reasons("surfel")
