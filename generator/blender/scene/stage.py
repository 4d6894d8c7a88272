"""Builds the Blender scene from a spec, reads the spec back out of any ``.blend``, and moves the target.

The file is the truth: which object plays which role is a custom property on the object (``nlos_role``), the voxel
grid is three custom properties on the scene, and the reflection order is what Cycles' own light-path panel shows. All
of them can be read and edited in Blender without any add-on.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import bpy

# isort: split
import bmesh  # exists only once bpy is imported
import mathutils
import numpy as np
from mathutils import Euler, Matrix, Quaternion

from generator.blender.scene import nodes, references
from generator.files import meshes
from generator.model import spec
from generator.model.spec import Array, NlosError

ROLE = "nlos_role"
BUILT = "nlos_built"
"""Of what `build` made, and may take away again."""
KIND = "nlos_target_kind"
SURFACE = "nlos_surface"
GRID_LO, GRID_HI, GRID_SHAPE = "nlos_grid_lo", "nlos_grid_hi", "nlos_grid_shape"
PRESET = "nlos_preset"
COLLECTION = "NLOS"

# Roles that exactly one object plays; "room" and "partition" are played by any number.
SINGLE_ROLES = ("relay_wall", "spot", "camera", "target")

_NO_SURFACE = ("LIGHT_PROBE", "CAMERA", "SPEAKER", "ARMATURE", "LATTICE")

_SLOT = "NLOS look"
"""Of the render result: what reading a scene leaves there is no picture."""

_THROUGH = {nodes.TRANSPARENT, nodes.TRANSMISSION, nodes.SUBSURFACE, nodes.VOLUME, nodes.UNKNOWN}
"""Ways in which light comes through a surface."""
_SHEAR = 1e-5
"""A frame is sheared if it differs by more from one that is not, in units of its scale."""

Result = TypeVar("Result")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence what Blender prints about its own doings (file descriptor 1, since C prints it)."""
    if sys.stdout is not None:
        sys.stdout.flush()
    try:
        saved = os.dup(1)
    except OSError:  # a windowed Blender may have no standard output at all
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)


class Overrides:
    """Set attributes of Blender's data and set them back on leaving, last first.

    Animation and drivers have their say when a render starts, and would overrule what is set; so those of just these
    attributes are muted for as long.
    """

    def __init__(self) -> None:
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Overrides:
        return self

    def set(self, owner: Any, name: str, value: Any) -> None:
        """Set an attribute until the block is left.

        Raises
        ------
        NlosError
            It is animated by an action that animates something else as well, which muting it would change.
        """
        for curve in animating(owner, name):
            self._undo.append(functools.partial(setattr, curve, "mute", False))
            curve.mute = True
        self._undo.append(functools.partial(setattr, owner, name, getattr(owner, name)))
        setattr(owner, name, value)

    def keep(self, owner: Any, *first: str) -> None:
        """Set back whatever will have changed of an owner's settings, where setting one changes others.

        Parameters
        ----------
        owner : bpy.types.bpy_struct
            With the settings that it owns, theirs too.
        *first : str
            Names of those that decide what others may be, in the order in which they do.
        """
        with quiet():  # Blender complains of colour spaces that are not set
            every = list(_plain(owner))
        before = sorted(every, key=lambda one: first.index(one[1]) if one[1] in first else len(first))
        self._undo.append(functools.partial(_set_back, owner, before))

    def __exit__(self, *_: object) -> None:
        for undo in reversed(self._undo):
            with contextlib.suppress(TypeError):  # what only another Blender or add-on knows, such as its engine
                undo()


def _plain(owner: Any, way: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str, Any]]:
    """Every value that can be set of an owner, and of what it owns: the way to whose it is, its name, and which."""
    for about in owner.bl_rna.properties:
        if about.type == "COLLECTION" or about.identifier == "rna_type":
            continue
        value = getattr(owner, about.identifier)
        if about.type == "POINTER":
            if value is not None and not isinstance(value, bpy.types.ID):
                yield from _plain(value, (*way, about.identifier))
        elif not about.is_readonly:
            yield way, about.identifier, tuple(value) if getattr(about, "is_array", False) else value


@quiet()
def _set_back(root: Any, before: list[tuple[tuple[str, ...], str, Any]]) -> None:
    for way, name, value in before:
        # Looked up anew: a change of colour management frees the curves of the old one.
        owner = functools.reduce(lambda holder, step: getattr(holder, step, None), way, root)
        if owner is None:
            continue
        now = getattr(owner, name)
        if (tuple(now) if isinstance(value, tuple) else now) != value:
            with contextlib.suppress(TypeError):  # likewise
                setattr(owner, name, value)


def animating(owner: Any, name: str) -> list[Any]:
    """Return the F-curves, among them drivers, that set an attribute when a render starts.

    Parameters
    ----------
    owner : bpy.types.bpy_struct
    name : str

    Raises
    ------
    NlosError
        One is in an action that animates something else as well.
    """
    block: Any = getattr(owner, "id_data", None)
    animation = getattr(block, "animation_data", None)
    if animation is None:
        return []
    found = [curve for curve in animation.drivers if _sets(curve, owner, name)]
    for action, slot in _actions(animation):
        curves = [curve for curve in _curves(action, slot) if _sets(curve, owner, name)]
        # Another scene's settings are not rendered.
        if curves and not isinstance(block, bpy.types.Scene) and _shared(action, slot):
            raise NlosError(
                f"{_file()}: {block.name!r} shares the action {action.name!r}, which animates its {name!r}, with "
                "something else; give it an action of its own"
            )
        found += curves
    return found


def _sets(curve: Any, owner: Any, name: str) -> bool:
    """Whether an F-curve that counts sets that attribute."""
    path = curve.data_path
    if curve.mute or not path.endswith((name, f'"{name}"]')):
        return False
    head = path.removesuffix(f'["{name}"]').removesuffix(name).removesuffix(".")
    if head in ("cycles", '["cycles"]'):  # Cycles' settings were custom properties until Blender 5
        return bool(owner == getattr(owner.id_data, "cycles", None))
    try:
        return bool((owner.id_data.path_resolve(head) if head else owner.id_data) == owner)
    except ValueError:  # it leads nowhere
        return False


def _actions(animation: Any) -> list[tuple[Any, Any]]:
    """Actions that animate a data-block, by itself or as strips, each with the handle of its slot, if any."""
    users, strips = [animation], [strip for track in animation.nla_tracks for strip in track.strips]
    while strips:
        strip = strips.pop()
        users.append(strip)
        strips += strip.strips  # of a meta-strip
    return [(user.action, getattr(user, "action_slot_handle", None)) for user in users if user.action is not None]


def _curves(action: Any, slot: Any) -> list[Any]:
    if not hasattr(action, "layers"):  # until Blender 4.3
        return list(action.fcurves)
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for bag in bags if bag.slot_handle == slot for curve in bag.fcurves]


def _shared(action: Any, slot: Any) -> bool:
    slots = [s for s in getattr(action, "slots", ()) if s.handle == slot]
    return len(slots[0].users()) > 1 if slots else action.users - action.use_fake_user > 1


def open_file(path: Path, known: Collection[Path] = ()) -> bpy.types.Scene:
    """Open a ``.blend``, running none of the scripts stored in it, and return its active scene.

    Parameters
    ----------
    path : Path
    known : collection of Path
        Files outside its folder that it may refer to.

    Raises
    ------
    NlosError
        There is no such file, Blender cannot read it, it refers to files elsewhere (`references.refuse`), or its
        pictures are made from files that are not there (`references.require`).
    """
    if not path.is_file():
        raise NlosError(f"{path}: no such scene file")
    references.refuse(path, known)
    try:
        with quiet():
            bpy.ops.wm.open_mainfile(filepath=literal(path), load_ui=False, use_scripts=False)
    except RuntimeError:
        raise NlosError(f"{path}: is not a scene Blender {bpy.app.version_string} can open") from None
    references.require(bpy.context.scene, path)
    return bpy.context.scene


def literal(path: Path, *, rendered: bool = False) -> str:
    """Return a path as Blender has to be given it.

    Two slashes at its start would be the open file's folder, and braces in a path that is rendered to would be
    variables, from Blender 5 on.
    """
    text = str(path)
    if text.startswith("//"):
        text = text[1:]
    if rendered and bpy.app.version >= (5, 0):
        text = text.replace("{", "{{").replace("}", "}}")
    return text


def save_file(path: Path) -> None:
    """Save a compressed copy of the open file by temporary name and rename; textures keep their place."""
    from generator.sets.dataset import atomic

    with atomic(path) as temporary, quiet():
        try:
            bpy.ops.wm.save_as_mainfile(
                filepath=literal(temporary), copy=True, compress=True, check_existing=False, relative_remap=True
            )
        except RuntimeError as error:
            raise NlosError(f"{path}: cannot be written ({' '.join(str(error).split())})") from None


def new_file() -> bpy.types.Scene:
    """Start an empty file and return its scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def build(scene: bpy.types.Scene, wanted: spec.Scene) -> None:
    """Build a scene from its spec, in place of what an earlier call built.

    Parameters
    ----------
    scene : bpy.types.Scene
        Objects without a role are left alone.
    wanted : spec.Scene

    Raises
    ------
    NlosError
        The mesh file cannot be read, the watched rectangle does not fit the resolution, or a surface has no area.
    """
    width, height = wanted.resolution
    x, z = wanted.camera.x, wanted.camera.z
    aspect = (x[1] - x[0]) / (z[1] - z[0])
    if abs(aspect - width / height) > 0.5 / max(width, height) * aspect:
        raise NlosError(
            f"resolution: {width} x {height} pixels do not fit the watched rectangle of "
            f"{x[1] - x[0]:g} x {z[1] - z[0]:g} m; pixels must be square"
        )
    # What can go wrong goes wrong first, and leaves the scene as it was.
    wanted.check_buildable()
    _cycles(scene)
    for obj in scene.objects:
        if ROLE in obj and obj.library is not None:
            raise NlosError(f"{_file()}: {obj.name!r} is linked from another file, so it cannot be replaced")
    target = _target(wanted.target)
    _clear(scene)
    collection = next((c for c in scene.collection.children if c.name == COLLECTION and c.library is None), None)
    if collection is None:
        collection = bpy.data.collections.new(COLLECTION)
        scene.collection.children.link(collection)
    for layer in scene.view_layers:
        layer.layer_collection.children[collection.name].exclude = False
    wall = _quad("Relay wall", "y", 0.0, {"x": wanted.wall.x, "z": wanted.wall.z}, wanted.wall.albedo, inward=1)
    _add(collection, wall, "relay_wall")
    if wanted.room:
        extent = {axis: getattr(wanted.room, axis) for axis in "xyz"}
        for surface in wanted.room.surfaces:
            axis, end = spec.FACES[surface]
            across = {a: r for a, r in extent.items() if a != axis}
            quad = _quad(
                surface.capitalize(), axis, extent[axis][end], across, wanted.room.albedo, inward=1 - 2 * end
            )
            quad[SURFACE] = surface
            quad.display_type = "WIRE"  # in the viewport only, where one wants to look inside
            _add(collection, quad, "room")
    if wanted.partition:
        for screen in _partition(wanted.partition):
            _add(collection, screen, "partition")
    _add(collection, _spot(wanted.spot), "spot")
    camera = _camera(wanted)
    _add(collection, camera, "camera")
    scene.camera = camera
    _add(collection, target, "target")
    target.location = np.add(wanted.grid.lo, wanted.grid.hi) / 2.0
    _world(scene, wanted.ambient)
    scene[PRESET] = wanted.preset
    write_grid(scene, wanted.grid)
    scene.render.resolution_x, scene.render.resolution_y = wanted.resolution
    scene.render.resolution_percentage = 100
    limit_reflections(scene, wanted.reflection_order)
    for obj in collection.objects:
        obj[BUILT] = True
    bpy.context.view_layer.update()


def limit_reflections(scene: bpy.types.Scene, order: int) -> None:
    """Let Cycles follow light over that many reflections and no more: the one place that translates.

    Cycles counts bounces after the camera ray's first hit, which is itself a reflection, so order n is n - 1 bounces.
    """
    cycles = _cycles(scene)
    scene.render.engine = "CYCLES"
    for kind in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces"):
        setattr(cycles, kind, order - 1)
    cycles.volume_bounces = 0
    # Russian roulette saves nothing on paths this short and adds noise.
    cycles.min_light_bounces = min(order, 1024)


def reflection_order(scene: bpy.types.Scene) -> int:
    """Return the reflection order that the scene's Cycles settings allow."""
    cycles = _cycles(scene)
    return int(min(cycles.max_bounces, cycles.diffuse_bounces)) + 1


def _cycles(scene: bpy.types.Scene) -> Any:
    """Return Cycles' settings, or say that it is switched off."""
    if not hasattr(scene, "cycles"):
        raise NlosError("Cycles is switched off: enable it in Preferences > Add-ons (Cycles Render Engine)")
    return scene.cycles


def write_grid(scene: bpy.types.Scene, grid: spec.VoxelGrid) -> None:
    """Store the voxel grid in the scene."""
    scene[GRID_LO], scene[GRID_HI], scene[GRID_SHAPE] = grid.lo, grid.hi, grid.shape


def find(scene: bpy.types.Scene, role: str) -> bpy.types.Object:
    """Return the one object that plays a role.

    Raises
    ------
    NlosError
        None does, or more than one does.
    """
    found = players(scene, role)
    words = role.replace("_", " ")
    if not found:
        raise NlosError(
            f"{_file()}: no object is the {words}; give one the custom property {ROLE} = {role!r} in Blender"
        )
    if len(found) > 1:
        names = ", ".join(repr(o.name) for o in found)
        raise NlosError(
            f"{_file()}: {len(found)} objects are named as {words} ({names}); only one may have {ROLE} = {role!r}"
        )
    return found[0]


def players(scene: bpy.types.Scene, role: str) -> list[bpy.types.Object]:
    """Return every object of the scene that plays a role."""
    return [o for o in scene.objects if o.get(ROLE) == role]


def unseen(scene: bpy.types.Scene, obj: bpy.types.Object) -> str:
    """Return why an object is not rendered, in words that follow its name; empty if it is."""
    if obj.hide_render:
        return "is hidden from renders"

    def shown(layer: Any) -> bool:
        if layer.exclude or layer.collection.hide_render:
            return False
        return obj.name in layer.collection.objects or any(map(shown, layer.children))

    if any(layer.use and shown(layer.layer_collection) for layer in scene.view_layers):
        return ""
    return "is in no collection that is rendered"


def show(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Let an object be rendered, and the collections that hold it."""
    obj.hide_render = False

    def open_up(layer: Any) -> bool:
        below = [open_up(child) for child in layer.children]  # all of them, not the first that holds it
        if obj.name in layer.collection.objects or any(below):
            if layer.exclude and layer.collection != scene.collection:
                layer.exclude = False
            layer.collection.hide_render = False
            return True
        return False

    for layer in scene.view_layers:
        open_up(layer.layer_collection)


def read(scene: bpy.types.Scene, resolution: tuple[int, int] | None = None) -> spec.Scene:
    """Read the spec back out of a scene, as edited, and as a render sees it.

    Parameters
    ----------
    scene : bpy.types.Scene
    resolution : (int, int), optional
        Of the pictures, width and height, on which depends what the camera sees; the scene's own if not given.

    Raises
    ------
    NlosError
        A role is missing or played twice, the voxel grid is missing, the relay wall is not in the plane y = 0, or the
        spot lamp does not point at it.
    """
    with Overrides() as overrides:
        return _read(scene, shape_pictures(scene, resolution, overrides))


def _read(scene: bpy.types.Scene, size: tuple[int, int]) -> spec.Scene:
    wall, lamp, camera, target = (find(scene, role) for role in SINGLE_ROLES)
    seen = snapshot(scene)
    low, high = _box(scene, [wall], seen)
    if not in_frame(wall, seen):
        raise NlosError(f"{_file()}: the relay wall {wall.name!r} must lie in the plane y = 0")
    if np.linalg.det(seen.matrices["target"]) < 0.0:
        raise NlosError(
            f"{_file()}: the target {target.name!r} is mirrored by a negative scale; apply the scale first"
        )
    room, screens = players(scene, "room"), players(scene, "partition")
    kind = target.get(KIND, "mesh")
    return spec.Scene(
        preset=str(scene.get(PRESET, "custom")),
        wall=spec.Wall(x=_range(low, high, 0), z=_range(low, high, 2), albedo=albedo(wall)),
        room=_read_room(scene, room, seen) if room else None,
        partition=_read_partition(scene, screens, seen) if screens else None,
        spot=_read_spot(lamp, seen.matrices["spot"]),
        camera=_read_camera(scene, camera, seen.matrices["camera"]),
        grid=read_grid(scene),
        target=spec.Target(
            kind=kind if kind in ("sheet", "sphere") else "mesh",
            size=short(max(np.ptp(hull(scene, seen), axis=0))),
            albedo=albedo(target),
        ),
        ambient=ambient(scene),
        reflection_order=reflection_order(scene),
        resolution=size,
    )


def others(scene: bpy.types.Scene) -> list[str]:
    """Return the names of rendered objects that play no role, nor belong to the target: what an artist added."""
    with_target = {child for target in players(scene, "target") for child in target.children_recursive}
    return sorted(
        o.name
        for o in scene.objects
        if ROLE not in o and o not in with_target and not o.hide_render and o.type not in ("EMPTY", "CAMERA")
    )


def target_parts(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the target and, after it, all its children that are rendered, theirs too: what moves together.

    Raises
    ------
    NlosError
        There is not exactly one target.
    """
    target = find(scene, "target")
    inside = set(scene.objects)
    children = [o for o in target.children_recursive if o in inside and ROLE not in o and not o.hide_render]
    return [target, *(o for o in children if o.type not in _NO_SURFACE)]


def hold_camera(scene: bpy.types.Scene, overrides: Overrides) -> None:
    """Let the camera by its role be the scene's, whatever cameras are bound to markers of the timeline."""
    overrides.set(scene, "camera", find(scene, "camera"))
    for marker in scene.timeline_markers:  # after it, for a marker that gets its camera back puts it into the scene
        if marker.camera is not None:
            overrides.set(marker, "camera", None)


def as_rendered(scene: bpy.types.Scene, look: Callable[[Any], Result]) -> Result:
    """Let a function look at the scene as a render would: Blender shows that to render engines only.

    The viewport's view, which scripts get elsewhere, has other subdivision levels and lacks what is hidden there.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    class Look(bpy.types.RenderEngine):  # type: ignore[misc]
        bl_idname = "NLOS_LOOK"
        bl_label = "NLOS look"

        def render(self, depsgraph: Any) -> None:
            try:
                results.append(look(depsgraph))
            except BaseException as error:  # Blender would print it and go on
                errors.append(error)

    bpy.utils.register_class(Look)
    try:
        with Overrides() as overrides, quiet(), _in_a_slot():
            hold_camera(scene, overrides)
            for name, value in (
                ("engine", Look.bl_idname),
                ("use_compositing", False),
                ("use_sequencer", False),
                ("use_freestyle", False),
                ("use_multiview", False),
                ("use_simplify", False),
                ("use_persistent_data", False),
            ):
                overrides.set(scene.render, name, value)
            bpy.ops.render.render(scene=scene.name)
    except RuntimeError as error:
        raise NlosError(f"{bpy.data.filepath or 'scene'}: cannot be read ({' '.join(str(error).split())})") from None
    finally:
        bpy.utils.unregister_class(Look)
    if errors:
        raise errors[0]
    if not results:
        raise NlosError(f"{bpy.data.filepath or 'scene'}: cannot be read, for none of its view layers is rendered")
    return results[0]


@contextlib.contextmanager
def _in_a_slot() -> Iterator[None]:
    """Let a render fill a slot of its own, so that the picture that the user rendered last stays."""
    result = next((image for image in bpy.data.images if image.type == "RENDER_RESULT"), None)
    if result is None:
        yield
        return
    slots = result.render_slots
    before = slots.active_index
    names = [slot.name for slot in slots]
    if _SLOT not in names:
        slots.new(name=_SLOT)
        names.append(_SLOT)
    slots.active_index = names.index(_SLOT)
    try:
        yield
    finally:
        slots.active_index = before


def shape_pictures(
    scene: bpy.types.Scene, resolution: tuple[int, int] | None, overrides: Overrides
) -> tuple[int, int]:
    """Give the scene the pictures' resolution, on which the camera's view depends, and square pixels.

    Parameters
    ----------
    scene : bpy.types.Scene
    resolution : (int, int) or None
        Width and height; the scene's own if None.
    overrides : Overrides

    Returns
    -------
    (int, int)
        The resolution.
    """
    render = scene.render
    share = render.resolution_percentage
    width, height = resolution or (
        max(1, render.resolution_x * share // 100),
        max(1, render.resolution_y * share // 100),
    )
    for name, value in (
        ("resolution_x", width),
        ("resolution_y", height),
        ("resolution_percentage", 100),
        ("pixel_aspect_x", 1.0),
        ("pixel_aspect_y", 1.0),
    ):
        overrides.set(render, name, value)
    return width, height


@dataclass(frozen=True)
class Shape:
    """A surface as a render sees it.

    Attributes
    ----------
    owner : bpy.types.Object
        The object that it belongs to; of an instance, the one that instances it.
    name : str
        Of the object whose mesh it is.
    instance : bool
    matrix : ndarray of shape (4, 4)
        Its place in the world.
    vertices : ndarray of shape (n, 3)
        In its own frame, after modifiers.
    triangles : ndarray of shape (m, 3), int
    air : bool
        Whether it is no surface at all, but the bounds of a volume.
    opaque : bool
        Whether no light comes through.
    """

    owner: bpy.types.Object
    name: str
    instance: bool
    matrix: Array
    vertices: Array
    triangles: Any
    air: bool = False
    opaque: bool = True

    @property
    def placed(self) -> Array:
        """Its vertices in the world, (n, 3), metres."""
        points: Array = self.vertices @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        return points


@dataclass
class Snapshot:
    """What stands where when a render starts: every surface, and the objects with a single role (4 x 4, by role)."""

    shapes: list[Shape] = field(default_factory=list)
    matrices: dict[str, Array] = field(default_factory=dict)

    def of(self, owners: Collection[bpy.types.Object]) -> list[Shape]:
        """Return the surfaces of some objects."""
        return [shape for shape in self.shapes if shape.owner in owners]


def snapshot(scene: bpy.types.Scene) -> Snapshot:
    """Return what stands where when a render of the scene starts.

    The viewport's view will not do: modifiers, levels of detail and visibility are set for each on their own, and an
    animation has its say when a render starts.

    Raises
    ------
    NlosError
        Nothing of the scene is rendered.
    """
    singles = {role: found[0] for role in SINGLE_ROLES if (found := players(scene, role))}

    def look(depsgraph: Any) -> Snapshot:
        seen = Snapshot()
        # Of what is not rendered at all only the viewport knows where it stands.
        for role, obj in singles.items():
            seen.matrices[role] = numbers(obj.matrix_world)
        for instance in depsgraph.object_instances:
            obj = instance.object
            if not instance.is_instance:
                for role in [r for r, single in singles.items() if single == obj.original]:
                    seen.matrices[role] = numbers(instance.matrix_world)
            if not instance.show_self or not isinstance(obj.data, bpy.types.Mesh):
                continue  # a curve or text comes a second time, as the mesh made of it
            vertices, triangles = _mesh_of(obj)
            if len(vertices):
                owner = (instance.parent if instance.is_instance else obj).original
                matrix = numbers(instance.matrix_world)
                kinds = {kind for slot in obj.material_slots for kind in nodes.kinds(slot.material)}
                air, opaque = kinds == {nodes.VOLUME}, not kinds & _THROUGH
                one = Shape(owner, obj.name, instance.is_instance, matrix, vertices, triangles, air, opaque)
                seen.shapes.append(one)
        return seen

    return as_rendered(scene, look)


def _mesh_of(evaluated: bpy.types.Object) -> tuple[Array, Any]:
    """Vertices (n, 3) and triangles (m, 3) of an evaluated object, in its own frame."""
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    evaluated.to_mesh_clear()
    return vertices.reshape(-1, 3).astype(np.float64), triangles.reshape(-1, 3)


def target_shape(scene: bpy.types.Scene, seen: Snapshot | None = None) -> tuple[Array, Any]:
    """Return what the target and its children are made of.

    Parameters
    ----------
    scene : bpy.types.Scene
    seen : Snapshot, optional
        Of the scene; it is looked at if not given.

    Returns
    -------
    vertices : ndarray of shape (n, 3)
        Metres, relative to the target's origin, unrotated but scaled.
    triangles : ndarray of shape (m, 3), int

    Raises
    ------
    NlosError
        There is not exactly one target, or it has no surface.
    """
    parts = target_parts(scene)
    target = parts[0]
    seen = seen or snapshot(scene)
    whole = Matrix(seen.matrices["target"].tolist())
    place, turn, scale = whole.decompose()
    back = Matrix.LocRotScale(place, turn, None).inverted()
    points, faces, count = [], [], 0
    for shape in seen.of(parts):
        if shape.owner == target and not shape.instance:
            points.append(shape.vertices * np.asarray(scale, dtype=np.float64))
        else:
            matrix = numbers(back @ Matrix(shape.matrix.tolist()))
            points.append(shape.vertices @ matrix[:3, :3].T + matrix[:3, 3])
        faces.append(shape.triangles + count)
        count += len(shape.vertices)
    if not count:
        why = unseen(scene, target)
        what = f"{why}; show it" if why else "has no surface to reflect light"
        raise NlosError(f"{_file()}: the target {target.name!r} {what}")
    return np.concatenate(points), np.concatenate(faces)


def hull(scene: bpy.types.Scene, seen: Snapshot | None = None) -> Array:
    """Return the vertices of the target and its children; see `target_shape`."""
    return target_shape(scene, seen)[0]


def numbers(value: Any) -> Array:
    """Return a matrix, vector or colour of Blender's as float64, the same to the bit in every Blender.

    From Blender 5.0 on NumPy finds float32 in them, columns first, and would compute with that.
    """
    return np.array(value, dtype=np.float64, order="C")


def evaluated_vertices(obj: bpy.types.Object) -> Array:
    """Return an object's vertices after modifiers, in its own frame, (n, 3); empty if it has no surface."""
    return _vertices(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def placed_vertices(obj: bpy.types.Object) -> Array:
    """Return an object's vertices after modifiers, in the world, (n, 3), metres; empty if it has no surface."""
    matrix = numbers(obj.matrix_world)
    placed: Array = evaluated_vertices(obj) @ matrix[:3, :3].T + matrix[:3, 3]
    return placed


def in_frame(wall: bpy.types.Object, seen: Snapshot | None = None) -> bool:
    """Whether a relay wall, as far as it has a surface, lies in the plane y = 0."""
    points = _points(seen.of([wall])) if seen else placed_vertices(wall)
    return not len(points) or bool(np.abs(points[:, 1]).max() <= 1e-5 * np.ptp(points, axis=0).max())


def _vertices(evaluated: bpy.types.Object) -> Array:
    try:
        mesh = evaluated.to_mesh()
    except RuntimeError:  # lamps, empties and the like
        mesh = None
    if mesh is None:  # or a mesh whose modifiers leave only curves, points or a volume
        return np.empty((0, 3))
    vertices = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", vertices)
    evaluated.to_mesh_clear()
    return vertices.reshape(-1, 3).astype(np.float64)


def move_target(scene: bpy.types.Scene, position: spec.Vector, rotation: spec.Vector) -> None:
    """Put the target's origin at a position, turned about x, then y, then z.

    Parameters
    ----------
    position : (float, float, float)
        Metres.
    rotation : (float, float, float)
        Degrees.

    Raises
    ------
    NlosError
        Something else holds the target in place: a constraint, a driver, an animation.
    """
    target = find(scene, "target")
    if target.parent is not None:
        _cut_loose(scene, target)
    # Never through the matrix: its scale, read back and set again, would drift by a rounding with every pose, and
    # the pixels would depend on the poses before.
    turn = Euler([math.radians(a) for a in rotation], "XYZ")
    target.rotation_mode = "XYZ"
    target.delta_location, target.delta_rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    target.location, target.rotation_euler = position, turn
    bpy.context.view_layer.update()
    if not target.visible_get():
        return  # the viewport does not know of it; what is rendered is looked at before a sweep (`extract.survey`)
    wanted = Matrix.LocRotScale(
        mathutils.Vector(position), turn, mathutils.Vector(target.scale) * mathutils.Vector(target.delta_scale)
    )
    got = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world
    tolerance = 1e-5 * (1.0 + max(map(abs, position)))
    if any(abs(a - b) > tolerance for r, s in zip(wanted, got, strict=True) for a, b in zip(r, s, strict=True)):
        raise NlosError(f"{_file()}: {held(target)}")


def held(target: bpy.types.Object) -> str:
    """Return that a target does not go where it is put, why, and what would mend it."""
    moves, name = target.animation_data, f"the target {target.name!r}"
    holders = [f"the constraint {c.name!r}" for c in target.constraints if c.enabled and not c.mute]
    if moves and moves.action:
        holders.append(f"the animation {moves.action.name!r}")
    if moves and any(track.strips and not track.mute for track in moves.nla_tracks):
        holders.append("its NLA strips")
    if moves and moves.drivers:
        holders.append("its drivers")
    if target.rigid_body:
        holders.append("its rigid body simulation")
    if not holders:
        return f"{name} does not go where it is put: something holds it"
    several = len(holders) > 1 or holders[0].endswith("s")
    return f"{name} does not go where it is put, because {' and '.join(holders)} {'hold' if several else 'holds'} it"


def _cut_loose(scene: bpy.types.Scene, target: bpy.types.Object) -> None:
    """Take the target from its parents and leave it the size that they give it."""
    matrix = Matrix(snapshot(scene).matrices["target"].tolist())
    scale = matrix.to_scale()
    plain = Matrix.LocRotScale(*matrix.decompose())
    if np.abs(numbers(plain) - numbers(matrix))[:3, :3].max() > _SHEAR * max(map(abs, scale)):
        raise NlosError(
            f"{_file()}: the target {target.name!r} is sheared by its parents' scale, which no pose can hold; "
            "apply that scale (Object > Apply > Scale), or make it visual geometry"
        )
    target.parent = None
    target.scale = [s / d for s, d in zip(scale, target.delta_scale, strict=True)]


@contextlib.contextmanager
def put_back(scene: bpy.types.Scene) -> Iterator[None]:
    """Put the target back on leaving, however it was moved."""
    target = find(scene, "target")
    # In this order: a parent set later would change what was set before it.
    names = [
        *("parent", "parent_type", "parent_bone", "matrix_parent_inverse", "rotation_mode", "location"),
        *("rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale"),
        *("delta_location", "delta_rotation_euler"),
    ]
    before = {name: getattr(target, name) for name in names}
    for name, value in before.items():
        if isinstance(value, mathutils.Vector | Euler | Quaternion | Matrix):
            before[name] = value.copy()  # else a view of what is going to change
    before["rotation_axis_angle"] = tuple(target.rotation_axis_angle)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(target, name, value)
        bpy.context.view_layer.update()


@contextlib.contextmanager
def stand_in(scene: bpy.types.Scene, wanted: spec.Target) -> Iterator[None]:
    """Put another object in the target's place, unturned; on leaving, take it away again."""
    parts = target_parts(scene)
    other = _target(wanted)
    other.location = parts[0].matrix_world.translation
    with Overrides() as overrides:
        for part in parts:
            overrides.set(part, "hide_render", True)
        del parts[0][ROLE]
        _add(scene.collection, other, "target")
        try:
            bpy.context.view_layer.update()
            yield
        finally:
            data, materials = other.data, list(other.data.materials)
            bpy.data.batch_remove([other, data, *materials])
            parts[0][ROLE] = "target"
    bpy.context.view_layer.update()


def albedo(obj: bpy.types.Object) -> float | None:
    """Return the mean albedo of an object's material if it is plainly Lambertian, else None."""
    colour = diffuse_colour(obj)
    return None if colour is None else short(sum(colour) / 3.0)


def diffuse_colour(obj: bpy.types.Object) -> tuple[float, float, float] | None:
    """Return the RGB albedo of an object whose only material is a constant Lambertian reflector, else None."""
    materials = {slot.material for slot in obj.material_slots}
    if len(materials) != 1 or None in materials:
        return None
    return nodes.diffuse(next(iter(materials)))


def ambient(scene: bpy.types.Scene) -> float:
    """Return the mean radiance of the world that is rendered, W/m^2/sr; of one with a texture, its strength.

    It is 0 only if the world gives no light.
    """
    return max((short(nodes.level(getattr(*held))) for held in worlds_of(scene)), default=0.0)


def worlds_of(scene: bpy.types.Scene) -> list[tuple[Any, str]]:
    """Return who holds a world that may be rendered, and in which attribute: the scene, or a view layer instead."""
    layers = [layer for layer in scene.view_layers if layer.use]
    own = [layer for layer in layers if getattr(layer, "world_override", None) is not None]
    owners: list[tuple[Any, str]] = [(layer, "world_override") for layer in own]
    return owners if len(own) == len(layers) or scene.world is None else [*owners, (scene, "world")]


def _file() -> str:
    return bpy.data.filepath or "scene"


def _clear(scene: bpy.types.Scene) -> None:
    """Take away what an earlier call built; objects of the user's own only lose their roles."""
    ours = scene.collection.children.get(COLLECTION)
    # Scenes that older versions built have no mark, but a collection of their own.
    built = [o for o in scene.objects if BUILT in o or (ROLE in o and ours is not None and o.name in ours.objects)]
    for obj in [o for o in scene.objects if ROLE in o and o not in built]:
        del obj[ROLE]
    for obj in built:
        data = obj.data
        bpy.data.objects.remove(obj, do_unlink=True)
        if data is not None and data.users == 0:
            bpy.data.batch_remove([data])
    unused = [m for m in bpy.data.materials if m.name.startswith("NLOS ") and m.users == 0]
    bpy.data.batch_remove(unused)


def _add(collection: bpy.types.Collection, obj: bpy.types.Object, role: str) -> None:
    obj[ROLE] = role
    collection.objects.link(obj)


def _material(name: str, reflectance: float | None) -> bpy.types.Material:
    material = bpy.data.materials.new(f"NLOS {name}")
    if material.node_tree is None:  # Blender 5 makes the tree itself and warns of the old switch
        material.use_nodes = True
    made = material.node_tree.nodes
    made.clear()
    value = 0.0 if reflectance is None else reflectance
    shader, output = made.new("ShaderNodeBsdfDiffuse"), made.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (value, value, value, 1.0)
    shader.inputs["Roughness"].default_value = 0.0
    output.location.x = 250.0
    material.node_tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    material.diffuse_color = (value, value, value, 1.0)
    return material


def _mesh(name: str, vertices: list[spec.Vector], faces: list[tuple[int, ...]], reflectance: float | None) -> Any:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(_material(name, reflectance))
    return bpy.data.objects.new(name, mesh)


def _quad(
    name: str, axis: str, at: float, across: dict[str, spec.Range], reflectance: float | None, *, inward: int
) -> bpy.types.Object:
    """A rectangle in a plane of constant ``axis``; its normal points along it if ``inward`` is 1, else back."""
    (a, (a0, a1)), (b, (b0, b1)) = across.items()
    corners = [{axis: at, a: u, b: v} for u, v in ((a0, b0), (a1, b0), (a1, b1), (a0, b1))]
    vertices = [(c["x"], c["y"], c["z"]) for c in corners]
    normal = np.cross(np.subtract(vertices[1], vertices[0]), np.subtract(vertices[2], vertices[1]))
    if normal["xyz".index(axis)] * inward < 0:
        vertices.reverse()
    return _mesh(name, vertices, [(0, 1, 2, 3)], reflectance)


def _partition(screen: spec.Partition) -> list[bpy.types.Object]:
    reflectance = screen.albedo
    quads = [_quad("Partition", "x", screen.x, {"y": screen.y, "z": screen.z}, reflectance, inward=-1)]
    if screen.depth > 0:
        reach = (screen.x, screen.x + screen.depth)
        quads.append(_quad("Partition side", "y", screen.y[0], {"x": reach, "z": screen.z}, reflectance, inward=-1))
    return quads


def _spot(lamp: spec.Spot) -> bpy.types.Object:
    light = bpy.data.lights.new("Spot", "SPOT")
    light.energy = lamp.power
    light.spot_size = 2.0 * math.radians(lamp.half_angle)
    light.spot_blend = 0.0
    light.shadow_soft_size = 0.0
    obj = bpy.data.objects.new("Spot", light)
    obj.location = lamp.location
    way = np.subtract(lamp.aim, lamp.location)  # in units of its own: Blender takes a short one for none
    obj.rotation_euler = mathutils.Vector(way / np.linalg.norm(way)).to_track_quat("-Z", "Y").to_euler()
    return obj


def _camera(wanted: spec.Scene) -> bpy.types.Object:
    view = wanted.camera
    camera = bpy.data.cameras.new("Camera")
    width = view.x[1] - view.x[0]
    distance = view.location[1]
    camera.sensor_fit = "HORIZONTAL"
    if view.projection == "orthographic":
        camera.type = "ORTHO"
        camera.ortho_scale = width
    else:
        camera.angle_x = 2.0 * math.atan2(width / 2.0, distance)
    # Facing the wall, the camera's right is -x.
    camera.shift_x = (view.location[0] - (view.x[0] + view.x[1]) / 2.0) / width
    camera.shift_y = ((view.z[0] + view.z[1]) / 2.0 - view.location[2]) / width
    camera.clip_start, camera.clip_end = 1e-3 * distance, 1e3 * distance
    obj = bpy.data.objects.new("Camera", camera)
    obj.location = view.location
    obj.rotation_euler = (math.pi / 2.0, 0.0, math.pi)
    return obj


def _target(wanted: spec.Target) -> bpy.types.Object:
    if wanted.kind == "sheet":
        h = wanted.size / 2.0
        target = _quad("Target", "y", 0.0, {"x": (-h, h), "z": (-h, h)}, wanted.albedo, inward=-1)
    elif wanted.kind == "sphere":
        target = _sphere(wanted)
    else:
        target = _import_mesh(wanted)
    target[KIND] = wanted.kind
    return target


def _sphere(wanted: spec.Target) -> bpy.types.Object:
    """A geodesic sphere of 5120 triangles with the true sphere's area.

    A convex body's mean projected area is a quarter of its surface (Cauchy 1841), so the light it catches is right on
    average over directions though its vertices stand out by 0.04 %.
    """
    radius = wanted.size / 2.0
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=5, radius=radius)
    area = sum(face.calc_area() for face in shape.faces)
    bmesh.ops.scale(shape, vec=[math.sqrt(4.0 * math.pi * radius**2 / area)] * 3, verts=shape.verts)
    mesh = bpy.data.meshes.new("Target")
    shape.to_mesh(mesh)
    shape.free()
    mesh.materials.append(_material("Target", wanted.albedo))
    return bpy.data.objects.new("Target", mesh)


def _import_mesh(wanted: spec.Target) -> bpy.types.Object:
    path = Path(wanted.mesh)
    if not path.is_file():
        raise NlosError(f"target.mesh: {path} is no such file")
    importers = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import, ".stl": bpy.ops.wm.stl_import}
    before = set(bpy.data.objects)
    try:
        with meshes.importable(path) as sound:
            importers[path.suffix.lower()](filepath=literal(sound.absolute()))
    except (OSError, RuntimeError, KeyError):
        raise NlosError(f"target.mesh: {path} is not a mesh file Blender can read (.obj, .ply, .stl)") from None
    shape = bmesh.new()
    for obj in [o for o in bpy.data.objects if o not in before]:
        data = obj.data
        if obj.type == "MESH":
            data.transform(obj.matrix_basis)
            shape.from_mesh(data)
        bpy.data.objects.remove(obj, do_unlink=True)
        if data is not None and data.users == 0:
            bpy.data.batch_remove([data])
    if not shape.faces:
        shape.free()
        raise NlosError(f"target.mesh: {path} holds no faces")
    corners = np.array([v.co for v in shape.verts], dtype=np.float64)
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent, area = max(high - low), sum(face.calc_area() for face in shape.faces)
    if not (0.0 < extent < math.inf and 0.0 < area < math.inf):
        shape.free()
        raise NlosError(
            f"target.mesh: {path} has no extent, or corners that are no places; its faces must have an area"
        )
    factor = wanted.size / extent if wanted.size else 1.0
    bmesh.ops.translate(shape, vec=-(low + high) / 2.0, verts=shape.verts)
    bmesh.ops.scale(shape, vec=[factor] * 3, verts=shape.verts)
    mesh = bpy.data.meshes.new("Target")
    shape.to_mesh(mesh)
    shape.free()
    mesh.materials.clear()
    mesh.materials.append(_material("Target", wanted.albedo))
    return bpy.data.objects.new("Target", mesh)


def _world(scene: bpy.types.Scene, radiance: float) -> None:
    old = scene.world
    if old is None or BUILT not in old or old.library is not None:
        if old is not None:
            old.use_fake_user = True  # somebody made it: kept, though this scene has another now
        scene.world = bpy.data.worlds.new("NLOS world")
        scene.world[BUILT] = True
    if bpy.app.version < (5, 0, 0) or scene.world.node_tree is None:  # Blender 5 has nothing else, and warns
        scene.world.use_nodes = True
    tree = scene.world.node_tree
    tree.nodes.clear()
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = radiance
    output.location.x = 250.0
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])


def _points(shapes: Sequence[Shape]) -> Array:
    """Vertices of surfaces in the world, (n, 3)."""
    points: Array = np.concatenate([np.empty((0, 3)), *(shape.placed for shape in shapes)])
    return points


def _box(scene: bpy.types.Scene, objects: list[bpy.types.Object], seen: Snapshot) -> tuple[Array, Array]:
    """Bounding box of rendered objects in the world, two arrays of shape (3,)."""
    every = _points(seen.of(objects))
    if not len(every):
        raise NlosError(f"{_file()}: {objects[0].name!r} {unseen(scene, objects[0]) or 'has no surface'}")
    return every.min(axis=0), every.max(axis=0)


def short(value: float) -> float:
    """Return the shortest decimal that Blender's float32 stands for: 0.05, not 0.05000000074505806."""
    return float(str(np.float32(value)))


def _range(low: Array, high: Array, axis: int) -> spec.Range:
    return (short(low[axis]), short(high[axis]))


def _read_room(scene: bpy.types.Scene, surfaces: list[bpy.types.Object], seen: Snapshot) -> spec.Room:
    low, high = _box(scene, surfaces, seen)
    names = {str(o.get(SURFACE)) for o in surfaces}
    return spec.Room(
        x=_range(low, high, 0),
        y=_range(low, high, 1),
        z=_range(low, high, 2),
        albedo=albedo(surfaces[0]) if len({albedo(o) for o in surfaces}) == 1 else None,
        surfaces=tuple(s for s in spec.ROOM_SURFACES if s in names),
    )


def _read_partition(scene: bpy.types.Scene, screens: list[bpy.types.Object], seen: Snapshot) -> spec.Partition:
    low, high = _box(scene, screens, seen)
    x = _range(low, high, 0)
    return spec.Partition(
        x=x[0],
        depth=short(x[1] - x[0]),
        y=_range(low, high, 1),
        z=_range(low, high, 2),
        albedo=albedo(screens[0]),
    )


def lamp_power(light: Any) -> float:
    """Return a lamp's power in watts, exposure and colour's mean included."""
    mean = sum(light.color) / 3.0
    return float(light.energy * 2.0 ** getattr(light, "exposure", 0.0) * mean)


def _read_spot(lamp: bpy.types.Object, place: Array) -> spec.Spot:
    if lamp.type != "LIGHT" or lamp.data.type != "SPOT":
        raise NlosError(f"{_file()}: the spot {lamp.name!r} must be a spot lamp")
    matrix = Matrix(place.tolist())
    origin, axis = matrix.translation, -matrix.to_3x3().col[2].normalized()
    if axis.y >= -1e-9 or origin.y <= 0.0:
        raise NlosError(f"{_file()}: the spot {lamp.name!r} does not point at the relay wall (the plane y = 0)")
    aim = origin - axis * (origin.y / axis.y)
    return spec.Spot(
        location=vector(origin),
        aim=vector(aim),
        half_angle=short(math.degrees(lamp.data.spot_size) / 2.0),
        power=lamp_power(lamp.data),
    )


def vector(values: Any) -> spec.Vector:
    """Return three of Blender's float32 as their shortest decimals."""
    return (short(values[0]), short(values[1]), short(values[2]))


def view(scene: bpy.types.Scene, camera: bpy.types.Object, place: Array | None = None) -> tuple[Array, Array]:
    """Return where the rays through a picture's corners start and where they meet the wall, (4, 3) each.

    Parameters
    ----------
    scene : bpy.types.Scene
        Its resolution is the pictures'.
    camera : bpy.types.Object
    place : ndarray of shape (4, 4), optional
        Where the camera stands; as the viewport has it if not given.

    Raises
    ------
    NlosError
        It is no plain camera, or does not look at the wall.
    """
    if camera.type != "CAMERA" or camera.data.type not in ("PERSP", "ORTHO"):
        raise NlosError(f"{_file()}: the camera {camera.name!r} must be a perspective or orthographic camera")
    matrix = camera.matrix_world if place is None else Matrix(place.tolist())
    # Cameras have no scale: Blender drops it.
    matrix = Matrix.LocRotScale(*matrix.decompose()[:2], mathutils.Vector(map(_sign, matrix.to_scale())))
    starts, corners = [], []
    for corner in camera.data.view_frame(scene=scene):
        parallel = camera.data.type == "ORTHO"
        start = matrix @ mathutils.Vector((corner.x, corner.y, 0.0)) if parallel else matrix.translation
        ray = matrix @ corner - start
        if ray.y >= 0.0 or start.y <= 0.0:
            raise NlosError(
                f"{_file()}: the camera {camera.name!r} does not look at the relay wall (the plane y = 0)"
            )
        starts.append(start)
        corners.append(start - ray * (start.y / ray.y))
    return np.array(starts), np.array(corners)


def _sign(value: float) -> float:
    return math.copysign(1.0, value)


def _read_camera(scene: bpy.types.Scene, camera: bpy.types.Object, place: Array) -> spec.Camera:
    _, points = view(scene, camera, place)
    low, high = points.min(axis=0), points.max(axis=0)
    return spec.Camera(
        location=vector(place[:3, 3]),
        x=_range(low, high, 0),
        z=_range(low, high, 2),
        projection="orthographic" if camera.data.type == "ORTHO" else "perspective",
    )


def read_grid(scene: bpy.types.Scene) -> spec.VoxelGrid:
    missing = [key for key in (GRID_LO, GRID_HI, GRID_SHAPE) if key not in scene]
    if missing:
        raise NlosError(f"{_file()}: lacks the voxel grid (custom property {missing[0]} of the scene)")
    if not all(hasattr(scene[key], "__len__") for key in (GRID_LO, GRID_HI, GRID_SHAPE)):
        raise NlosError(
            f"{_file()}: the voxel grid (custom properties {GRID_LO} and so on) must be three lists of three"
        )
    data = {
        "lo": [short(v) for v in scene[GRID_LO]],
        "hi": [short(v) for v in scene[GRID_HI]],
        "shape": [int(v) for v in scene[GRID_SHAPE]],
    }
    grid: spec.VoxelGrid = spec.from_dict(spec.VoxelGrid, data, "grid.")
    return grid
