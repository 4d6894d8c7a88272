"""Edit every property of a scene, one by one: does each engine render what plain Cycles does, or report why not?

``python benchmarks/properties.py -o FOLDER`` edits a small scene through Blender's own description of its data
(``bl_rna``), saves it, opens it, renders it by plain Cycles - a call of its render operator, none of our code - and
as a sweep would by each engine. Hand-made edits of nodes, modifiers, collections, instances and animation
(`edits.py`) are judged the same way. Every edit ends as one of

follows
    `path` equals plain Cycles to the bit; `patch` and `surfel` lie within their intervals around it.
replaced
    The picture is that of the scene before the edit, to the bit, and the product says that it replaces the setting.
refused
    A message says what the product cannot follow.
wrong
    Anything else: other pixels than Cycles', without a message.

The folder gets ``edits-N.csv``, a line per edit, ``table.md``, and the counts as ``properties-VERSION.csv``.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import re
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import results

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

SIZE = (8, 8)
SAMPLES = 64
"""Samples of the pictures that are compared to the bit."""
QUICK, QUICK_REPEATS, QUICK_CRITICAL = 1024, 4, 3.0
"""Samples, pictures and standard errors of the first comparison: a picture within these is right, to some 10 % of the
difference picture and 5 % of the background. The noise is the base scene's, known better than from four pictures."""
MANY, REPEATS = 2048, 12
"""Samples and pictures of the second comparison, where the first finds a difference."""
RARE = 16 * MANY
"""Samples of a third comparison, if some picture of the second has no path that met the light: no known spread."""
CRITICAL = 7.0
"""Student's t with about 15 degrees of freedom: one false alarm in 100,000 comparisons, of which an edit has 21."""
TOLERANCE = {"patch": 3e-3, "surfel": 3e-3}
"""Relative difference allowed besides noise: the engines' own accuracy, of which 1e-3 is requested, and rounding."""
AMBIENT_TOLERANCE = 0.01
"""Tolerance of `surfel` under ambient light, as requested of the difference picture."""
ENGINES = ("path", "patch", "surfel")
PATIENCE = 240.0
"""Seconds after which a process that edits counts as hung."""


@dataclass
class Row:
    """Result of an edit."""

    owner: str
    name: str
    value: str
    plain: str = ""
    """Result of plain Cycles: unchanged, changed, fails."""
    path: str = ""
    patch: str = ""
    surfel: str = ""
    reason: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def label(self) -> str:
        return f"{self.owner} | {self.name} = {self.value}"


# --------------------------------------------------------------------------------------------------------------------
# The edits: owners of properties, and the values to try
# --------------------------------------------------------------------------------------------------------------------

NEUTRAL = {
    "cycles": {
        "device": "CPU",
        "use_adaptive_sampling": False,
        "use_denoising": False,
        "time_limit": 0.0,
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "blur_glossy": 0.0,
        "light_sampling_threshold": 0.0,
        "pixel_filter_type": "BOX",
        "sampling_pattern": "TABULATED_SOBOL",
        "samples": SAMPLES,
    },
    "render": {
        "engine": "CYCLES",
        "use_compositing": False,
        "use_sequencer": False,
        "resolution_x": SIZE[0],
        "resolution_y": SIZE[1],
        "threads_mode": "AUTO",
    },
}
"""Settings of the file that is edited: Cycles without denoiser, clamping or filter, as a sweep renders."""

OWN = {"camera", "filepath", "resolution_x", "resolution_y", "samples", "seed", "threads", "threads_mode", "device"}
"""Settings that the command line sets or that belong to a role, and that plain Cycles is given here too."""

SKIPPED = {
    "name", "rna_type", "tag", "use_fake_user", "name_full", "library", "session_uid", "mode", "select", "hide",
    "asset_data", "preview", "is_runtime_data", "is_evaluated", "id_type", "original", "users", "override_library",
    "is_embedded_data", "is_missing", "is_library_indirect", "is_editable",
}  # fmt: skip
FACES_ONLY = {
    "color", "color_tag", "display_shape", "height", "hide_value", "link_limit", "location", "location_absolute",
    "parent", "pin_gizmo", "select", "show_expanded", "show_options", "show_preview", "show_texture", "type",
    "use_custom_color", "warning_propagation", "width", "inferred_structure_type", "enabled", "description",
    "hide", "is_expanded", "bl_icon", "bl_static_type", "active_preview", "is_panel_collapsed",
}  # fmt: skip
"""Properties of nodes, sockets and links that affect only how the node editor draws them."""


def base_scene() -> Any:
    """Build the scene that is edited, in place of the open one."""
    import bpy
    import edits

    from generator.blender.scene import blend_file, build, roles

    scene = blend_file.new_file()
    build.build(scene, edits.BASE)
    for owner, settings in NEUTRAL.items():
        for name, value in settings.items():
            setattr(getattr(scene, owner), name, value)
    for role in roles.SINGLE_ROLES:
        roles.find(scene, role).name = role.replace("_", " ").capitalize()
    bpy.context.view_layer.update()
    return scene


def base_file() -> Path:
    """Build and save the scene that is edited; return its path."""
    import bpy

    path = Path(tempfile.mkdtemp(prefix="nlos-properties-")) / "base.blend"
    base_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    return path


def owners() -> dict[str, Callable[[Any], Any]]:
    """Return functions from a scene to the structures whose properties are edited, by their names in the table."""
    import edits

    part, material = edits.part, edits.material
    accessors: dict[str, Callable[[Any], Any]] = {}

    def add(label: str, way: Callable[[Any], Any]) -> None:
        accessors[label] = way

    def below(label: str, way: Callable[[Any], Any], *names: str) -> None:
        for name in names:
            add(f"{label}.{name}", lambda s, way=way, name=name: getattr(way(s), name))

    for role in ("target", "relay_wall", "room", "spot", "camera"):
        label = role.replace("relay_", "")
        add(f"object {label}", lambda s, role=role: part(s, role))
        below(f"object {label}", lambda s, role=role: part(s, role), "cycles", "light_linking")
    add("light spot", lambda s: part(s, "spot").data)
    below("light spot", lambda s: part(s, "spot").data, "cycles")
    add("light spot nodes", lambda s: edits._spot_nodes(s)[1].id_data)
    add("camera camera", lambda s: part(s, "camera").data)
    below("camera camera", lambda s: part(s, "camera").data, "cycles", "dof", "stereo")
    for role in ("target", "relay_wall", "room"):
        label = role.replace("relay_", "")
        add(f"mesh {label}", lambda s, role=role: part(s, role).data)
        add(f"material {label}", lambda s, role=role: material(s, role))
        below(f"material {label}", lambda s, role=role: material(s, role), "cycles")
        add(f"slot {label}", lambda s, role=role: part(s, role).material_slots[0])
    _node_owners(add)
    add("world", lambda s: s.world)
    below("world", lambda s: s.world, "cycles", "cycles_visibility", "light_settings", "mist_settings")
    add("world bright", lambda s: (edits._sky(s), s.world)[1])
    below("world bright", lambda s: (edits._sky(s), s.world)[1], "cycles", "cycles_visibility")
    add("view layer", lambda s: s.view_layers[0])
    below("view layer", lambda s: s.view_layers[0], "cycles", "eevee")
    add("layer collection", lambda s: s.view_layers[0].layer_collection.children[0])
    add("collection", lambda s: s.collection.children[0])
    add("scene", lambda s: s)
    below(
        "scene", lambda s: s,
        "cycles", "cycles_curves", "render", "view_settings", "display_settings", "unit_settings",
        "grease_pencil_settings",
    )  # fmt: skip
    below(
        "render", lambda s: s.render,
        "image_settings",
    )  # fmt: skip
    below(
        "image_settings", lambda s: s.render.image_settings,
        "linear_colorspace_settings", "display_settings", "view_settings", "stereo_3d_format",
    )  # fmt: skip
    for kind in MODIFIERS:
        add(f"modifier target {kind}", lambda s, kind=kind: part(s, "target").modifiers.new("Edited", kind))
    for kind in ("SUBSURF", "DISPLACE"):
        add(f"modifier wall {kind}", lambda s, kind=kind: part(s, "relay_wall").modifiers.new("Edited", kind))
    for kind in ("ARRAY",):
        add(f"modifier room {kind}", lambda s, kind=kind: part(s, "room").modifiers.new("Edited", kind))
    for kind in CONSTRAINTS:
        add(f"constraint spot {kind}", lambda s, kind=kind: part(s, "spot").constraints.new(kind))
        add(f"constraint target {kind}", lambda s, kind=kind: part(s, "target").constraints.new(kind))
    return accessors


MODIFIERS = (
    "ARRAY", "BEVEL", "BUILD", "CAST", "DECIMATE", "DISPLACE", "EDGE_SPLIT", "MIRROR", "NORMAL_EDIT", "SCREW",
    "SIMPLE_DEFORM", "SMOOTH", "SOLIDIFY", "SUBSURF", "TRIANGULATE", "WAVE", "WEIGHTED_NORMAL", "WELD",
)  # fmt: skip
"""Not WIREFRAME: a frame of some hundred faces takes `surfel` minutes per edit."""
CONSTRAINTS = ("LIMIT_LOCATION", "LIMIT_ROTATION")


def _node_owners(add: Callable[[str, Callable[[Any], Any]], None]) -> None:
    """Add nodes, their sockets and their links: of the materials as they are, and of shaders in their place."""
    import edits

    part, material = edits.part, edits.material

    def shader(role: str, kind: str) -> Callable[[Any], Any]:
        return lambda s: edits.shaded(edits.fresh(material(s, role)), kind)

    def sockets(label: str, way: Callable[[Any], Any], names: Sequence[str]) -> None:
        add(label, way)
        for name in names:
            add(f"{label} [{name}]", lambda s, name=name: way(s).inputs[name])

    for role in ("target", "relay_wall", "room"):
        label = role.replace("relay_", "")
        diffuse = lambda s, role=role: material(s, role).node_tree.nodes["Diffuse BSDF"]  # noqa: E731
        end = lambda s, role=role: edits.output_of(material(s, role).node_tree)  # noqa: E731
        sockets(f"node {label} diffuse", diffuse, ["Color", "Roughness", "Normal"])
        sockets(f"node {label} output", end, ["Surface", "Volume", "Displacement", "Thickness"])
        add(f"node {label} link", lambda s, role=role: material(s, role).node_tree.links[0])
        for kind, names in SHADERS.items():
            short = kind.removeprefix("ShaderNode")
            if role != "room" or short in ("BsdfPrincipled", "Emission"):
                for name in names:
                    way = shader(role, kind)
                    add(f"node {label} {short} [{name}]", lambda s, way=way, name=name: way(s).inputs[name])
    spot = lambda s: edits._spot_nodes(s)  # noqa: E731
    sockets("node spot emission", lambda s: spot(s)[1], ["Color", "Strength"])
    add("node spot output", lambda s: spot(s)[2])
    add("node spot link", lambda s: spot(s)[0].links[0])
    sockets("node world background", lambda s: edits._sky(s)[1], ["Color", "Strength"])
    add("node world output", lambda s: edits.output_of(edits._sky(s)[0]))
    add("node world link", lambda s: edits._sky(s)[0].links[0])
    assert part


SHADERS = {
    "ShaderNodeBsdfPrincipled": (
        "Base Color", "Metallic", "Roughness", "IOR", "Alpha", "Diffuse Roughness", "Subsurface Weight",
        "Subsurface Radius", "Subsurface Scale", "Specular IOR Level", "Specular Tint", "Anisotropic",
        "Transmission Weight", "Coat Weight", "Coat Roughness", "Sheen Weight", "Emission Color",
        "Emission Strength", "Thin Film Thickness",
    ),
    "ShaderNodeEmission": ("Color", "Strength"),
    "ShaderNodeBsdfTranslucent": ("Color",),
    "ShaderNodeBsdfTransparent": ("Color",),
    "ShaderNodeBsdfAnisotropic": ("Color", "Roughness"),
    "ShaderNodeBsdfGlass": ("Color", "Roughness", "IOR"),
    "ShaderNodeBsdfSheen": ("Color", "Roughness"),
    "ShaderNodeSubsurfaceScattering": ("Color", "Scale"),
    "ShaderNodeHoldout": (),
}  # fmt: skip


def values(struct: Any, prop: Any) -> list[Any]:
    """Return the values to try for a property, without its current value."""
    now = getattr(struct, prop.identifier)
    if prop.type == "BOOLEAN":
        if not prop.is_array:
            return [not now]
        now = list(now)
        return [[not now[0], *now[1:]], [not v for v in now]]
    if prop.type == "ENUM":
        items = [item.identifier for item in prop.enum_items]
        if prop.is_enum_flag:
            return [{item} for item in items if {item} != set(now)][:4]
        return [item for item in items if item != now][:6]
    if prop.type in ("INT", "FLOAT"):
        return _numbers(prop, now)
    return []


def _numbers(prop: Any, now: Any) -> list[Any]:
    is_int = prop.type == "INT"
    low, high = (max(prop.hard_min, prop.soft_min), min(prop.hard_max, prop.soft_max))
    first = now
    while hasattr(first, "__len__"):
        first = first[0]
    # Never far from the current value: large counts and levels soon take gigabytes.
    candidates = [low, 2 * first + 1, first / 2, first + 0.3, first - 0.3, min(high, 8)]
    tried: list[Any] = []
    for value in candidates:
        value = min(max(value, low, first - 4.0), high, max(first + 4.0, 2 * abs(first) + 1.0))
        value = int(value) if is_int else float(value)
        if value != first and value not in tried and math.isfinite(value):
            tried.append(value)
    if not prop.is_array:
        return tried[:2]
    arrays: list[Any] = []
    flat = np.array(now, dtype=float)
    for number, value in enumerate(tried[:2]):
        new = flat.copy()
        if number == 0:
            new.flat[0] = value
        else:
            new += value - first
            new = np.clip(new, low, high)
        arrays.append(new.astype(int).tolist() if is_int else new.tolist())
    return arrays


def pointers(scene: Any, prop: Any, now: Any) -> dict[str, Callable[[], Any]]:
    """Return functions that make other data for a property that refers to data, by their names in the table."""
    import bpy
    import edits

    def texture() -> Any:
        return bpy.data.textures.new("Other", "CLOUDS")

    def world() -> Any:
        new_world = bpy.data.worlds.new("Other")
        node = edits.shaded(edits.fresh(new_world), "ShaderNodeBackground", "ShaderNodeOutputWorld")
        node.inputs["Strength"].default_value = 0.3
        return new_world

    kind = prop.fixed_type.identifier
    makers: dict[str, Callable[[], Any]] = {
        "Object": lambda: edits.part(scene, "room"),
        "Material": lambda: edits.new_material("Other", Color=(0.3, 0.3, 0.3, 1.0)),
        "Collection": lambda: bpy.data.collections.new("Other"),
        "World": world,
        "Texture": texture,
        "Mesh": lambda: edits.box("Other", 0.3),
        "Scene": lambda: bpy.data.scenes.new("Other"),
    }
    choices = {f"another {kind}": makers[kind]} if kind in makers else {}
    if now is not None and not prop.is_never_none:
        choices["None"] = lambda: None
    return choices


def catalogue() -> list[tuple[str, str, str]]:
    """Return every edit as owner, property and value in words; print how many are left out and why."""
    import edits

    from generator.blender.scene import blend_file

    base = base_file()
    scene = blend_file.open_file(base)
    listed = [("by hand", name, "") for name in edits.EDITS]
    left_out: Counter[str] = Counter()
    for owner, way in owners().items():
        scene = blend_file.open_file(base)
        try:
            struct = way(scene)
        except (AttributeError, KeyError, IndexError, TypeError, RuntimeError):
            left_out["not in this Blender"] += 1
            continue
        if struct is None:
            left_out["not in this Blender"] += 1
            continue
        for prop in struct.bl_rna.properties:
            name = prop.identifier
            skipped = SKIPPED | FACES_ONLY if owner.startswith("node ") else SKIPPED
            if prop.is_readonly or name in skipped or name.startswith("bl_"):
                left_out["read only, or a name or flag of the user interface"] += 1
            elif prop.type in ("STRING", "COLLECTION"):
                left_out["text, or a list"] += 1
            elif prop.type == "POINTER":
                listed += [(owner, name, text) for text in pointers(scene, prop, getattr(struct, name))]
            else:
                listed += [(owner, name, json.dumps(_plain(v))) for v in values(struct, prop)]
    for reason, count in left_out.items():
        print(f"left out: {count} properties, {reason}", file=sys.stderr)
    return listed


def _plain(value: Any) -> Any:
    return sorted(value) if isinstance(value, set) else value


def apply(scene: Any, owner: str, name: str, value: str, folder: Path) -> None:
    """Make one edit of the open base scene."""
    import edits

    if owner == "by hand":
        edits.EDITS[name].edit(scene, folder)
        return
    struct = owners()[owner](scene)
    prop = struct.bl_rna.properties[name]
    if prop.type == "POINTER":
        new = pointers(scene, prop, getattr(struct, name))[value]()
    else:
        new = json.loads(value)
        new = set(new) if prop.type == "ENUM" and prop.is_enum_flag else new
    setattr(struct, name, new)


# --------------------------------------------------------------------------------------------------------------------
# Pictures: plain Cycles', and the product's
# --------------------------------------------------------------------------------------------------------------------

Pose = tuple[Sequence[float], Sequence[float]]
Pair = tuple[Any, Any]
"""A picture with the target and one without."""


class Plain:
    """Renders a file by a call of Blender's render operator and nothing else.

    Parameters
    ----------
    file : Path
        File to open.
    pose : (position, rotation)
        Pose of the target, metres and degrees.
    """

    def __init__(self, file: Path, pose: Pose, folder: Path) -> None:
        import bpy
        from mathutils import Euler, Matrix, Vector

        bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False, use_scripts=False)
        self.scene = bpy.context.scene
        self._picture = folder / "plain.exr"
        self._targets = [o for o in self.scene.objects if o.get("nlos_role") == "target"]
        if len(self._targets) != 1:
            raise LookupError(f"{len(self._targets)} targets")
        target = self.target = self._targets[0]
        turn = Euler([math.radians(v) for v in pose[1]], "XYZ")
        scale = target.matrix_world.to_scale()
        target.rotation_mode = "XYZ"
        target.location, target.rotation_euler = pose[0], turn
        bpy.context.view_layer.update()
        self.wanted = Matrix.LocRotScale(Vector(pose[0]), turn, scale)
        self.nudged = self._off() > 1e-5
        """Whether the target was placed by a matrix, which rounds."""
        if self.nudged:
            target.matrix_world = self.wanted
            bpy.context.view_layer.update()
        render, image = self.scene.render, self.scene.render.image_settings
        if hasattr(image, "media_type"):
            image.media_type = "IMAGE"
        image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGB", "32", "NONE"
        render.engine = "CYCLES"
        render.resolution_x, render.resolution_y = SIZE
        render.resolution_percentage = 100
        render.use_file_extension = False
        render.filepath = str(self._picture)
        self.scene.cycles.device = "CPU"

    def _off(self) -> float:
        """Return how far the target is from where it was put."""
        import bpy

        got = self.target.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world
        return max(abs(a - b) for r, s in zip(self.wanted, got, strict=True) for a, b in zip(r, s, strict=True))

    def stays(self) -> bool:
        """Return whether the target is where it was put after the animation is evaluated."""
        self.scene.frame_set(self.scene.frame_current)
        return self._off() <= 1e-5

    def pair(self, samples: int, seed: int) -> Pair:
        """Render the scene with the target, and without."""
        import bpy

        from generator.blender.scene.quiet import quiet

        pictures = []
        self.scene.cycles.samples, self.scene.cycles.seed = samples, seed
        hidden = [self.target, *(o for o in self.target.children_recursive if o.type != "EMPTY")]
        for part in (None, hidden):
            before = [(o, o.hide_render) for o in part or ()]
            for obj, _ in before:
                obj.hide_render = True
            self._picture.unlink(missing_ok=True)
            with quiet():
                bpy.ops.render.render(write_still=True, scene=self.scene.name)
            for obj, old in before:
                obj.hide_render = old
            pictures.append(read(self._picture))
        return pictures[0], pictures[1]


def read(path: Path) -> Any:
    """Return a picture's pixels."""
    from generator.files.pictures import read_picture

    return read_picture(path)[0]


class Product:
    """Renders a file as a sweep does, by one engine."""

    def __init__(self, file: Path, engine: str) -> None:
        from generator.blender import sweep_worker
        from generator.blender.engines import survey
        from generator.blender.engines.settings import settled
        from generator.blender.scene import blend_file, references, replaced, roles
        from generator.blender.scene.description import read_scene

        references.refuse(file)
        self.scene = blend_file.open_file(file)
        references.require(self.scene, file)
        described = read_scene(self.scene)
        roles.refuse_hidden(self.scene)
        chosen = {"poses": 1, "engine": engine, "resolution": list(SIZE), "rotation": list(TURN)}
        self.sweep, _ = settled(self.scene, described, chosen)
        survey.survey(self.scene, resolution=self.sweep.resolution).check(engine)
        self.described = read_scene(self.scene, self.sweep.resolution)
        sweep_worker.doubted(self.scene, self.sweep, force=False)
        self.records = sweep_worker.placed(self.scene, self.described, self.sweep)
        announced = {setting.path.rsplit(".", 1)[-1] for setting in replaced.replaced(self.scene)}
        unannounced = {s.path.rsplit(".", 1)[-1] for s in (*replaced.OUTPUT, *replaced.SAMPLING) if not s.words}
        self.replaces = announced | unannounced | OWN

    @property
    def first(self) -> Pose:
        """The first pose that a sweep plans."""
        return self.records[0].position, self.records[0].rotation

    def may_stand(self, pose: Pose) -> bool:
        """Return whether a sweep might plan a pose: the target is in the voxels, and nothing is in the way."""
        from generator.blender.scene import geometry
        from generator.blender.scene.clearance import clearance
        from generator.blender.scene.quiet import Overrides
        from generator.model.arrays import rotation_matrix

        grid, (position, rotation) = self.described.grid, pose
        corners = geometry.hull(self.scene) @ rotation_matrix(rotation).T + position
        if not ((corners > np.array(grid.lo) - 1e-6) & (corners < np.array(grid.hi) + 1e-6)).all():
            return False
        with Overrides() as overrides:
            geometry.shape_pictures(self.scene, self.sweep.resolution, overrides)
            return bool(clearance(self.scene, self.described, engine=self.sweep.engine)(position, rotation))

    def pairs(self, pose: Pose, shots: Sequence[tuple[int, int]]) -> list[Pair]:
        """Render for each (samples, seed) a picture with the target and one without."""
        from generator.blender.engines import renderers
        from generator.blender.engines.surfel import SurfelRenderer
        from generator.blender.scene import posing

        pictures = []
        with renderers.opened(self.scene, self.sweep.engine, **renderers.settings(self.sweep)) as renderer:
            if isinstance(renderer, SurfelRenderer):
                return [(renderer.at(*pose), renderer.render(target=False))]
            posing.move_target(self.scene, *pose)
            for samples, seed in shots:
                picture = renderer.render(samples=samples, seed=seed)
                pictures.append((picture, renderer.render(samples=samples, seed=seed, target=False)))
        return pictures


TURN = (15.0, 15.0, 30.0)


# --------------------------------------------------------------------------------------------------------------------
# The judge
# --------------------------------------------------------------------------------------------------------------------


def figures(pair: Pair) -> Any:
    """Return the 21 quantities to compare: means of channels and quarters of difference, background and picture."""
    picture, background = (np.asarray(p, dtype=np.float64) for p in pair)
    means = []
    for part in (picture - background, background, picture):
        h, w = part.shape[0] // 2, part.shape[1] // 2
        grey = part.mean(axis=2)
        quarters = [grey[:h, :w], grey[:h, w:], grey[h:, :w], grey[h:, w:]]
        means += [*part.mean(axis=(0, 1)), *(q.mean() for q in quarters)]
    return np.array(means)


def differ(ours: Sequence[Pair], theirs: Sequence[Pair], tolerance: float, noise: Any = None) -> str:
    """Return where two sets of pictures differ by more than their noise explains; empty if nowhere.

    Parameters
    ----------
    ours, theirs : sequences of pairs
        A single picture of ours has no noise.
    tolerance : float
        Relative.
    noise : two arrays of shape (21,), optional
        Relative standard deviations of our figures and theirs, where they are known beforehand.
    """
    a, b = (np.array([figures(p) for p in pairs]) for pairs in (ours, theirs))
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return "not finite"
    level = levels(b)
    variances = [x.var(axis=0, ddof=1) / len(x) if len(x) > 1 else np.zeros(21) for x in (a, b)]
    critical = CRITICAL
    if noise is not None:
        critical = QUICK_CRITICAL
        known = [(n * level) ** 2 / len(x) for n, x in zip(noise, (a, b), strict=True)]
        variances = [np.maximum(v, k) for v, k in zip(variances, known, strict=True)]
    half = critical * np.sqrt(sum(variances)) + tolerance * level + 1e-7 * level[20]
    gap = a.mean(axis=0) - b.mean(axis=0)
    worst = int(np.argmax(np.abs(gap) / (half + 1e-30)))
    if abs(gap[worst]) <= half[worst]:
        return ""
    kind = ("difference", "background", "picture")[worst // 7]
    return f"{kind} {a[:, worst].mean():.4g}, Cycles {b[:, worst].mean():.4g} +- {half[worst]:.2g}"


def levels(figured: Any) -> Any:
    """Return the mean size of the figures of difference, background and picture, (21,)."""
    return np.repeat([np.abs(figured[:, 7 * i : 7 * i + 7]).mean() for i in range(3)], 7)


def equal(ours: Pair, theirs: Pair) -> bool:
    """Return whether pictures are equal to the bit."""
    return all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


class Judge:
    """Applies edits to the base scene and judges how each engine renders them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.base = base_file()
        self.instead: tuple[str, Any] | None = None
        """Setting, with its value, that a sweep replaces in the current file and that plain Cycles is given too."""
        self.pose = Product(self.base, "path").first
        if not all(Product(self.base, engine).may_stand(self.pose) for engine in ENGINES):
            raise AssertionError("the pose is none that every engine would plan")
        self.plain = [*self._plain(self.base, SAMPLES, [7]), *self._plain(self.base, MANY, range(100, 100 + REPEATS))]
        self.ours = {engine: self._ours(self.base, engine, SAMPLES, [7]) for engine in ENGINES}
        self.ours["patch"] += self._ours(self.base, "patch", MANY, range(500, 500 + REPEATS))
        self.noise = {"plain": self._noise(self.plain[1:]), "patch": self._noise(self.ours["patch"][1:])}
        self.noise["surfel"] = np.zeros(21)
        for engine in ENGINES[1:]:
            ours = self.ours[engine][1:] or self.ours[engine]
            if why := differ(ours, self.plain[1:], TOLERANCE[engine]):
                raise AssertionError(f"{engine} in the base scene: {why}")
        if not equal(self.ours["path"][0], self.plain[0]):
            raise AssertionError("path is not plain Cycles in the base scene")

    @staticmethod
    def _noise(pairs: Sequence[Pair]) -> Any:
        """Return the relative noise of the quantities of a picture of `QUICK` samples, from pictures of `MANY`."""
        quantities = np.array([figures(p) for p in pairs])
        return quantities.std(axis=0, ddof=1) / levels(quantities) * math.sqrt(MANY / QUICK)

    def _cycles(self, file: Path, pose: Pose) -> Plain:
        cycles = Plain(file, pose, self.folder)
        if self.instead:
            setattr(cycles.scene.render, *self.instead)
        return cycles

    def _plain(self, file: Path, samples: int, seeds: Sequence[int], pose: Pose | None = None) -> list[Pair]:
        # The file is opened again, so that Cycles has no state of earlier renders.
        cycles = self._cycles(file, pose or self.pose)
        return [cycles.pair(samples, seed) for seed in seeds]

    def _ours(self, file: Path, engine: str, samples: int, seeds: Sequence[int]) -> list[Pair]:
        return Product(file, engine).pairs(self.pose, [(samples, seed) for seed in seeds])

    def row(self, owner: str, name: str, value: str) -> Row:
        """Make an edit, render it by plain Cycles and every engine, and return the result."""
        import bpy
        import edits

        from generator.blender.scene import blend_file

        start = time.monotonic()
        row = Row(owner, name, value)
        scene = blend_file.open_file(self.base)
        file = self.folder / "edited.blend"
        try:
            apply(scene, owner, name, value, self.folder)
        except (TypeError, ValueError, AttributeError, RuntimeError) as error:
            row.plain = "not accepted"
            row.reason["plain"] = " ".join(str(error).split())[:200]
            return row
        bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
        case = edits.EDITS[name] if owner == "by hand" else None
        self.instead = case.instead if case else None
        ours = {engine: rendered for engine in ENGINES if (rendered := self._asked(row, file, engine))}
        if ours:  # otherwise plain Cycles is not needed; with some files it never ends
            self._judge(row, file, ours, case)
        row.seconds = time.monotonic() - start
        return row

    def _asked(self, row: Row, file: Path, engine: str) -> tuple[Product, Pose, Pair] | None:
        """Return an engine's pictures of an edit, and their pose; None, recorded in the row, if there are none."""
        from generator.model.errors import NlosError

        try:
            product = Product(file, engine)
            pose = self.pose if product.may_stand(self.pose) else product.first  # where the target differs
            return product, pose, product.pairs(pose, [(SAMPLES, 7)])[0]
        except NlosError as error:
            setattr(row, engine, "refused")
            row.reason[engine] = str(error).replace(str(file), "scene").replace(str(self.folder), "")
        except Exception as error:
            setattr(row, engine, "wrong")
            row.reason[engine] = f"traceback: {type(error).__name__}: {error}"[:300]
        return None

    def _judge(self, row: Row, file: Path, ours: dict[str, tuple[Product, Pose, Pair]], case: Any) -> None:
        """Render an edit by plain Cycles, and record the verdict on each engine."""
        expect = case.expect if case else "cycles"
        plain: dict[Pose, dict[int, list[Pair]]] = {}
        for engine, (product, pose, pair) in ours.items():
            if pose not in plain:
                plain[pose] = self._plainly(row, file, pose)
                if row.plain == "moves":
                    row.plain, expect = "changed", "refuse"
            if expect == "refuse":
                verdict, why = "wrong", "should be refused"
            elif case and case.solid and (why := self._inside(case.solid, file, engine)):
                verdict = "wrong"
            else:
                verdict, why = self._verdict(file, product, pose, pair, plain[pose], expect, row.name)
                if self.instead and verdict == "follows":
                    verdict = "replaced" if self.instead[0] in product.replaces else "wrong"
            setattr(row, engine, verdict)
            if why:
                row.reason[engine] = why

    def _plainly(self, row: Row, file: Path, pose: Pose) -> dict[int, list[Pair]]:
        """Return plain Cycles' first pictures of an edit; empty if there are none. Record if its target moves."""
        try:
            cycles = self._cycles(file, pose)
            pair = cycles.pair(SAMPLES, 7)
            self.rounded = cycles.nudged
            row.plain = "unchanged" if pose == self.pose and equal(pair, self.plain[0]) else "changed"
            if not cycles.stays():
                row.plain = "moves"
            return {SAMPLES: [pair]}
        except (LookupError, RuntimeError, OSError, ValueError, TypeError, AttributeError) as error:
            row.plain = "fails"
            row.reason["plain"] = " ".join(str(error).split())[:200]
            return {}

    def _verdict(
        self,
        file: Path,
        product: Product,
        pose: Pose,
        ours: Pair,
        plain: dict[int, list[Pair]],
        expect: str,
        name: str,
    ) -> tuple[str, str]:
        """Return the verdict on an engine's pictures of an edit, and the reason."""
        engine = product.sweep.engine
        base = self.ours[engine][0]
        same = equal(ours, base)
        if engine == "surfel":
            same = all(np.allclose(a, b, rtol=3e-6) for a, b in zip(ours, base, strict=True))
        if expect == "base":
            return ("replaced", "") if same else ("wrong", "not as without the edit")
        replaced = same and name in product.replaces
        if SAMPLES not in plain:
            return ("replaced", "") if replaced else ("wrong", "Cycles alone makes no picture")
        changed = pose != self.pose or not equal(plain[SAMPLES][0], self.plain[0])
        if equal(ours, plain[SAMPLES][0]) if engine == "path" else same and not changed:
            return "follows", ""
        if self.rounded and same:
            changed = not all(
                np.allclose(a, b, rtol=1e-4) for a, b in zip(plain[SAMPLES][0], self.plain[0], strict=True)
            )
            if not changed:
                return "follows", ""
        if replaced:
            return "replaced", ""
        still = "; as without the edit" if same else ""
        if engine == "path":
            return "wrong", _ratios(ours, plain[SAMPLES][0]) + still
        tolerance = TOLERANCE[engine]
        if engine == "surfel" and product.described.ambient:
            tolerance = AMBIENT_TOLERANCE
        noise = (self.noise[engine], self.noise["plain"])
        why = ""
        looks = ((QUICK, QUICK_REPEATS, noise), (MANY, REPEATS, None), (RARE, REPEATS, None))
        for samples, repeats, known in looks:
            if samples not in plain:
                plain[samples] = self._plain(file, samples, range(100, 100 + repeats), pose)
            pairs = (
                [ours]
                if engine == "surfel"
                else Product(file, engine).pairs(pose, [(samples, seed) for seed in range(500, 500 + repeats)])
            )
            why = differ(pairs, plain[samples], tolerance, known)
            if not why:
                return "follows", ""
            if samples == MANY and all(background.any() for _, background in plain[samples]):
                break
        return "wrong", why + still

    def _inside(self, solid: Callable[[Any], Any], file: Path, engine: str) -> str:
        """Return why a planned pose is impossible: the target, a sheet, is in a box; empty if it is not."""
        import edits

        from generator.model.arrays import rotation_matrix

        product = Product(file, engine)
        low, high = solid(product.scene)
        steps = np.linspace(-0.5, 0.5, 13) * edits.BASE.target.size
        x, z = (v.ravel() for v in np.meshgrid(steps, steps))
        sheet = np.stack([x, np.zeros_like(x), z], axis=1)
        record = product.records[0]
        points = sheet @ rotation_matrix(record.rotation).T + record.position
        share = float(((points > low) & (points < high)).all(axis=1).mean())
        return f"{share:.0%} of the target stands inside a solid" if share else ""


def _ratios(ours: Pair, theirs: Pair) -> str:
    """Return by how much two pictures and their backgrounds differ, in words."""
    means = [float(np.mean(a)) / max(1e-30, float(np.mean(b))) for a, b in zip(ours, theirs, strict=True)]
    gap = float(np.abs(ours[0] - theirs[0]).max() / max(1e-30, np.abs(theirs[0]).max()))
    return f"picture {means[0]:.3f}, background {means[1]:.3f} of Cycles, pixels off by up to {gap:.1e}"


# --------------------------------------------------------------------------------------------------------------------
# Processes, and the table
# --------------------------------------------------------------------------------------------------------------------


def serve() -> None:
    """Judge the edits that come as lines of JSON on standard input; one line of JSON answers each."""
    from generator.model import poses

    poses._TRIES_TURNING = 2000  # an edit that leaves no room is refused with the same message, but sooner
    out = sys.stdout
    with tempfile.TemporaryDirectory(prefix="nlos-properties-") as folder:
        judge = Judge(Path(folder))
        print("ready", file=out, flush=True)
        for line in sys.stdin:
            print(json.dumps(asdict(judge.row(*json.loads(line)))), file=out, flush=True)


class Server:
    """A process that runs `serve`."""

    def __init__(self, patience: float) -> None:
        self._patience = patience
        command = [sys.executable, __file__, "--serve"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        if self._answer(3 * PATIENCE) != "ready":
            raise SystemExit("the base scene cannot be judged; its reason is above")

    def _answer(self, patience: float) -> str:
        """Return the next line that `serve` wrote; empty if the process ends, or is silent for too long."""
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline:
            if select.select([self._process.stdout], [], [], 1.0)[0]:
                line = self._process.stdout.readline()
                if not line or line.startswith(("ready", "{")):
                    return line.strip()
        return ""

    def judge(self, edit: Sequence[str]) -> Row | None:
        """Return the result of an edit; None if the process did not survive it."""
        self._process.stdin.write(json.dumps(list(edit)) + "\n")
        self._process.stdin.flush()
        line = self._answer(self._patience)
        return Row(**json.loads(line)) if line else None

    def stop(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()


def run(listed: Sequence[Sequence[str]], report: Callable[[Row], None], patience: float = PATIENCE) -> None:
    """Judge edits in a separate process, which is started again after an edit that ends it."""
    server = Server(patience)
    for number, edit in enumerate(listed):
        if number and number % 400 == 0:  # frees the memory that Blender keeps of hundreds of files
            server.stop()
            server = Server(patience)
        row = server.judge(edit)
        if row is None:
            server.stop()
            server = Server(patience)
            row = Row(*edit, plain="ends Blender")
        report(row)
    server.stop()


RESULTS = {"properties-*": ("of", "edits", "change Cycles' picture", "followed", "replaced", "refused", "wrong")}


def counted(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Return the columns of `RESULTS` for each owner, and for all."""
    judged = [row for row in rows if row.path]
    groups: dict[str, list[Row]] = {}
    for row in judged:
        groups.setdefault(group(row.owner), []).append(row)
    found = []
    for name, members in [*groups.items(), ("all", judged)]:
        cells = (
            " / ".join(str(sum(getattr(r, engine) == verdict for r in members)) for engine in ENGINES)
            for verdict in VERDICTS
        )
        found.append((name, str(len(members)), str(sum(r.plain == "changed" for r in members)), *cells))
    return found


def table(rows: Sequence[Row], blender: str) -> str:
    """Return the table of verdicts by owner and the lists of what is not followed, in Markdown."""
    judged = [row for row in rows if row.path]
    properties = {(r.owner, r.name) for r in judged}
    lines = [
        f"## Blender {blender}",
        "",
        f"{len(judged)} edits of {len(properties)} properties. Cells: `path` / `patch` / `surfel`.",
        "",
        f"| {' | '.join(RESULTS['properties-*'])} |",
        "|---|--:|--:|--:|--:|--:|--:|",
        *(f"| {' | '.join(cells)} |" for cells in counted(rows)),
    ]
    lines += ["", "Replaced: " + _named(r for r in judged if "replaced" in verdicts(r)) + ".", ""]
    for count, words in ((3, "every engine"), (2, "`patch` and `surfel`"), (1, "`surfel` alone")):
        lines += [
            f"Refused by {words}: " + _named(r for r in judged if verdicts(r).count("refused") == count) + ".",
            "",
        ]
    lines += [f"- **wrong**: {r.label}: {' / '.join(verdicts(r))}" for r in judged if "wrong" in verdicts(r)]
    outside = [r for r in rows if r.plain == "ends Blender"]
    lines += [f"- left out, for no answer within {PATIENCE:g} s: {r.owner}, {r.name}" for r in outside]
    refused = sum(r.plain == "not accepted" for r in rows)
    lines += [f"- left out, since Blender does not accept the value: {refused} edits"] * bool(refused)
    return "\n".join(lines)


VERDICTS = ("follows", "replaced", "refused", "wrong")


def verdicts(row: Row) -> list[str]:
    """Return the verdicts on an edit, one per engine."""
    return [getattr(row, engine) for engine in ENGINES]


def _named(rows: Iterable[Row]) -> str:
    """Return the names of properties as text, by the line of the table that they belong to."""
    names: dict[str, dict[str, None]] = {}
    for row in rows:
        names.setdefault(group(row.owner), {})[row.name if "[" not in row.owner else row.owner[5:]] = None
    return "; ".join(f"{line} ({', '.join(members)})" for line, members in names.items()) or "nothing"


def stored(path: Path) -> list[Row]:
    """Return the rows of a file that `main` wrote."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [Row(**{k: v for k, v in row.items() if k not in ("reason", "seconds")}) for row in rows]


def group(owner: str) -> str:
    """Return the line of the table that an owner belongs to."""
    first = owner.split(".")[0]
    words = first.split()
    return {"by": "by hand", "node": "nodes", "view": "view layer", "layer": "collection"}.get(words[0], words[0])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the sweep of properties."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, help="folder of the results")
    parser.add_argument(
        "--only", default="", help="regular expression: edits whose 'owner | name = value' it matches"
    )
    parser.add_argument("--patience", type=float, default=PATIENCE, help="seconds for an edit (default: %(default)g)")
    parser.add_argument("--shard", default="0/1", help="i/n: every n-th edit, from the i-th on")
    parser.add_argument("--judged", type=Path, nargs="+", default=[], help="leave out the edits in these files")
    parser.add_argument("--merge", type=Path, nargs="+", help="make the table from these files; of two, the later")
    parser.add_argument("--blender", default="", help="the Blender of those, for the heading")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.serve:
        serve()
        return 0
    if options.merge:
        rows = {row.label: row for path in options.merge for row in stored(path)}
        print(table(list(rows.values()), options.blender))
        if options.output:
            name = f"properties-{options.blender}"
            results.write(options.output, name, RESULTS["properties-*"], counted(list(rows.values())))
        return 0
    import bpy

    options.output.mkdir(parents=True, exist_ok=True)
    index, _, count = options.shard.partition("/")
    judged = {row.label for path in options.judged for row in stored(path)}
    listed = [e for e in catalogue() if re.search(options.only, label := Row(*e).label) and label not in judged]
    listed = listed[int(index) :: int(count)]
    rows: list[Row] = []
    path = options.output / f"edits-{index}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["owner", "name", "value", "plain", *ENGINES, "reason", "seconds"])

        def report(row: Row) -> None:
            rows.append(row)
            reasons = {}
            for engine, text in row.reason.items():
                reasons.setdefault(text, []).append(engine)
            explained = "; ".join(f"{', '.join(names)}: {text}" for text, names in reasons.items())
            verdicts = [getattr(row, engine) for engine in ENGINES]
            writer.writerow([row.owner, row.name, row.value, row.plain, *verdicts, explained, f"{row.seconds:.2f}"])
            file.flush()
            if "wrong" in verdicts or row.plain == "ends Blender":
                print(f"{row.label} [{row.plain}]: {' '.join(verdicts)}: {explained}", flush=True)

        run(listed, report, options.patience)
    text = table(rows, bpy.app.version_string)
    (options.output / "table.md").write_text(text + "\n", encoding="utf-8")
    if count in ("", "1"):  # a share's table is none of the whole
        results.write(options.output, f"properties-{bpy.app.version_string}", RESULTS["properties-*"], counted(rows))
    print(text)
    return int(any("wrong" in (r.path, r.patch, r.surfel) for r in rows))


if __name__ == "__main__":
    sys.exit(main())
