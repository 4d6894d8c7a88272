"""The target's way along the timeline: its pose at each frame as a render sees it, and what else changes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from generator.blender.scene import geometry, posing, roles
from generator.blender.scene.quiet import moving_paths
from generator.blender.scene.words import file_name, vector
from generator.model.arrays import Array
from generator.model.errors import NlosError, require
from generator.model.poses import Pose

_SAME = 1e-5
"""Metres, or share of a value, below which two frames count as equal."""
_TRANSFORMS = ("location", "rotation", "scale", "delta_", "constraints", "pose", "modifiers", "hide_viewport")
"""Starts of the paths of what moves or shapes an object, which is seen by where its surface is."""
_CUSTOM = '["'
"""Start of the paths of custom properties."""


@dataclass(frozen=True)
class Timeline:
    """The target's poses, frame by frame.

    Attributes
    ----------
    frames : (int, int, int)
        Numbers of the first and of the last frame, and the step from one to the next.
    fps : float
        Frames of the timeline in a second.
    poses : list of ((float, float, float), (float, float, float))
        Position, metres, and rotation about x, then y, then z, degrees.
    """

    frames: tuple[int, int, int]
    fps: float
    poses: list[Pose]

    @property
    def numbers(self) -> range:
        """Numbers of the frames."""
        first, last, step = self.frames
        return range(first, last + 1, step)


def take(scene: bpy.types.Scene, frames: Sequence[int] = ()) -> Timeline:
    """Read the target's poses, and let it go: nothing moves it any more, and it stands at the first.

    Parameters
    ----------
    scene : bpy.types.Scene
    frames : sequence of int
        First frame, last frame and step; empty for those of the scene.

    Raises
    ------
    NlosError
        The target does not move, changes its shape or is simulated, or something else changes meanwhile.
    """
    chosen = tuple(frames) or (scene.frame_start, scene.frame_end, scene.frame_step)
    require(
        len(chosen) == 3 and chosen[0] <= chosen[1] and chosen[2] >= 1,
        f"timeline: {':'.join(map(str, chosen))} must be the first frame, the last one and a step of 1 or more",
    )
    first, last, step = chosen
    target = roles.find(scene, "target")
    if target.rigid_body is not None:
        raise NlosError(
            f"{file_name()}: the target {target.name!r} is simulated as a rigid body; bake that to keyframes "
            "(Object > Rigid Body > Bake to Keyframes)"
        )
    found, before = [], None
    for frame in range(first, last + 1, step):
        scene.frame_set(frame)
        now = _Frame(scene)
        before = before or now
        before.check(now, f"from frame {first} to frame {frame}")
        found.append(now.matrix)
    poses = [_pose(matrix) for matrix in found]
    if not any(np.abs(np.subtract(pose, poses[0])).max() > _SAME for pose in poses):
        raise NlosError(
            f"{file_name()}: the target {target.name!r} stands still from frame {first} to frame {last}; give it "
            "keyframes there, or name other frames"
        )
    scene.frame_set(first)
    _let_go(scene, target, found[0])
    rate = scene.render.fps / scene.render.fps_base
    return Timeline((first, last, step), float(rate), poses)


def _pose(matrix: Array) -> Pose:
    place, turn, _ = Matrix(matrix.tolist()).decompose()
    x, y, z = (math.degrees(angle) for angle in turn.to_euler("XYZ"))
    return vector(place), (x, y, z)


def _let_go(scene: bpy.types.Scene, target: bpy.types.Object, matrix: Array) -> None:
    posing.cut_loose(scene, target)
    target.animation_data_clear()
    for constraint in list(target.constraints):
        target.constraints.remove(constraint)
    scale = Matrix(matrix.tolist()).to_scale()
    target.scale = [s / d for s, d in zip(scale, target.delta_scale, strict=True)]
    posing.move_target(scene, *_pose(matrix))


class _Frame:
    """What a render at the current frame would see."""

    def __init__(self, scene: bpy.types.Scene) -> None:
        seen = geometry.snapshot(scene)
        parts = roles.target_parts(scene)
        self.matrix = seen.matrices["target"]
        self._target = parts[0].name
        self._shape = geometry.target_shape(scene, seen)[0]
        self._surfaces = {
            (shape.owner.name, shape.name, k): shape.placed
            for k, shape in enumerate(shape for shape in seen.shapes if shape.owner not in parts)
        }
        self._moved = {
            obj.name: np.array(obj.matrix_world) for obj in scene.objects if obj.type in ("LIGHT", "CAMERA")
        }
        self._values = dict(_values(scene, parts))

    def check(self, now: _Frame, when: str) -> None:
        """Raise NlosError, with the name of what differs, unless only the target has moved."""
        if self._shape.shape != now._shape.shape or _differ(self._shape, now._shape):
            raise NlosError(
                f"{file_name()}: the target {self._target!r} changes its shape or size {when}; only its place and "
                "its rotation may change"
            )
        for kind, before, after in (
            ("is another or elsewhere", self._surfaces, now._surfaces),
            ("moves", self._moved, now._moved),
            ("changes", self._values, now._values),
        ):
            for key in [*before, *(key for key in after if key not in before)]:
                if key not in before or key not in after or _differ(before[key], after[key]):
                    name = repr(key[0] if isinstance(key, tuple) else key)
                    what = f"{key[1]} of {name}" if kind == "changes" else name
                    raise NlosError(
                        f"{file_name()}: {what} {kind} {when}; only the target may, so take its keyframes away"
                    )


def _differ(one: Any, other: Any) -> bool:
    a, b = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    return a.shape != b.shape or bool((np.abs(a - b) > _SAME * (1.0 + np.abs(a))).any())


def _values(scene: bpy.types.Scene, parts: Sequence[bpy.types.Object]) -> Iterator[tuple[tuple[str, str], Any]]:
    """Yield the animated values that change light but neither place nor shape, with who owns them and their path."""
    blocks: dict[Any, str] = {scene: scene.name}
    for obj in scene.objects:
        blocks[obj] = obj.name
        if isinstance(obj.data, bpy.types.Light | bpy.types.Camera):
            blocks[obj.data] = obj.name
        for slot in obj.material_slots:
            if slot.material is not None:
                blocks[slot.material] = slot.material.name
    if scene.world is not None:
        blocks[scene.world] = scene.world.name
    for block, name in list(blocks.items()):
        trees = [block.node_tree] if getattr(block, "node_tree", None) else []
        while trees:
            tree = trees.pop()
            if tree not in blocks:
                blocks[tree] = name
                trees += [node.node_tree for node in tree.nodes if getattr(node, "node_tree", None)]
    for block, name in blocks.items():
        for path in moving_paths(block):
            if isinstance(block, bpy.types.Object):
                drives = path.startswith(_CUSTOM) and (block in parts or block.type in ("EMPTY", "ARMATURE"))
                if drives or path.startswith(_TRANSFORMS):
                    continue  # a custom property of the target or of a rig may drive the target
            if isinstance(block, bpy.types.Scene) and not path.endswith("bounces"):
                continue  # all else that lights a scene belongs to other blocks, or is replaced (`replaced`)
            try:
                value = block.path_resolve(path)
            except ValueError:  # the path leads nowhere
                continue
            if isinstance(value, bool | int | float):
                yield (name, path), float(value)
            elif hasattr(value, "__len__") and not isinstance(value, str):
                yield (name, path), [float(v) for v in value]
