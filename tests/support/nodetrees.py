"""Node trees and small scenes for tests of what Cycles evaluates."""

from __future__ import annotations

import bpy
import radiometry

from generator.blender.scene import blend_file, build, posing

WHITE = (1.0, 1.0, 1.0, 1.0)


def tree_of(block):
    """The empty node tree of a material, world or lamp."""
    always = (5, 2) if isinstance(block, bpy.types.Light) else (5, 0)
    if (
        block.node_tree is None or bpy.app.version < always
    ):  # to ask for nodes is deprecated where they are taken always
        block.use_nodes = True
    block.node_tree.nodes.clear()
    return block.node_tree


def node(tree, kind, into=None, **inputs):
    """A new node with those inputs, its first output linked into a socket."""
    made = tree.nodes.new(f"ShaderNode{kind}")
    for name, value in inputs.items():
        made.inputs[name].default_value = value
    if into is not None:
        tree.links.new(made.outputs[0], into)
    return made


def output(tree, kind="Material", target="ALL"):
    """A new output node; its target says which engines take it."""
    made = tree.nodes.new(f"ShaderNodeOutput{kind}")
    made.target = target
    return made


def paint(obj, kind, **inputs):
    """Make an object of one shader; return its tree."""
    made = bpy.data.materials.new("Odd")
    tree = tree_of(made)
    node(tree, kind, output(tree).inputs["Surface"], **inputs)
    obj.data.materials.clear()
    obj.data.materials.append(made)
    return tree


def bare(**changes):
    """The wall, spot and sheet of `radiometry.bare_scene`, four pixels wide, the sheet turned a little."""
    scene = blend_file.new_file()
    build.build(scene, radiometry.bare_scene(resolution=(4, 4), **changes))
    posing.move_target(scene, (0.0, 1.0, 0.0), (10.0, 0.0, 20.0))
    return scene
