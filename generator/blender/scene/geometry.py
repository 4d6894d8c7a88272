"""Shapes and transforms of objects as a render sees them, and the camera's view of the wall."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import bpy
import mathutils
import numpy as np
from mathutils import Matrix, Quaternion

from generator.blender.scene import nodes, replaced
from generator.blender.scene.quiet import Overrides, quiet
from generator.blender.scene.roles import SINGLE_ROLES, find, players, target_parts, unseen
from generator.blender.scene.words import file_name, numbers
from generator.model.arrays import Array
from generator.model.errors import NlosError

_SLOT = "NLOS look"
"""Slot of the render result that reading a scene uses; it holds no picture."""


_THROUGH = {nodes.TRANSPARENT, nodes.TRANSMISSION, nodes.SUBSURFACE, nodes.VOLUME, nodes.UNKNOWN}
"""Kinds of scattering that let light through a surface."""


Result = TypeVar("Result")


def hold_camera(scene: bpy.types.Scene, overrides: Overrides) -> None:
    """Make the object with the camera role the scene's camera, whatever cameras timeline markers are bound to."""
    overrides.set(scene, "camera", find(scene, "camera"))
    for marker in scene.timeline_markers:  # last, so restored first: restoring a marker's camera sets the scene's
        if marker.camera is not None:
            overrides.set(marker, "camera", None)


def as_rendered(scene: bpy.types.Scene, look: Callable[[Any], Result]) -> Result:
    """Call a function with the scene as evaluated for a render, which Blender passes to render engines only.

    Scripts otherwise get the viewport's evaluation, with other subdivision levels and without what is hidden there.
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
            replaced.replace(scene, overrides, replaced.IMAGES)
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
    """Render into a separate slot, so that the picture that the user rendered last is kept."""
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
    """Set the scene's resolution, on which the camera's view depends, to the pictures' and make pixels square.

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
    percentage = render.resolution_percentage
    width, height = resolution or (
        max(1, render.resolution_x * percentage // 100),
        max(1, render.resolution_y * percentage // 100),
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
        Object that the surface belongs to; for an instance, the object that instances it.
    name : str
        Name of the object that has the mesh.
    instance : bool
    matrix : ndarray of shape (4, 4)
        Transform from the object's frame to the world.
    vertices : ndarray of shape (n, 3)
        In the object's frame, after modifiers.
    triangles : ndarray of shape (m, 3), int
    air : bool
        Whether it only bounds a volume and is no surface.
    opaque : bool
        Whether it lets no light through.
    materials : tuple of bpy.types.Material or None
    slots : ndarray of shape (m,), int
        Which of the materials each triangle has.
    """

    owner: bpy.types.Object
    name: str
    instance: bool
    matrix: Array
    vertices: Array
    triangles: Any
    air: bool = False
    opaque: bool = True
    materials: tuple[Any, ...] = (None,)
    slots: Any = 0

    @property
    def placed(self) -> Array:
        """The vertices in the world, (n, 3), metres."""
        points: Array = self.vertices @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        return points


@dataclass
class Snapshot:
    """The scene when a render starts: all surfaces, and the transforms (4 x 4) of single-role objects, by role."""

    shapes: list[Shape] = field(default_factory=list)
    matrices: dict[str, Array] = field(default_factory=dict)

    def of(self, owners: Collection[bpy.types.Object]) -> list[Shape]:
        """Return the surfaces of the given objects."""
        return [shape for shape in self.shapes if shape.owner in owners]


def snapshot(scene: bpy.types.Scene) -> Snapshot:
    """Return surfaces and transforms as they are when a render of the scene starts.

    The viewport's evaluation is not enough: modifiers, levels of detail and visibility are set separately for it, and
    animation is applied only when a render starts.

    Raises
    ------
    NlosError
        Nothing of the scene is rendered.
    """
    singles = {role: objects[0] for role in SINGLE_ROLES if (objects := players(scene, role))}

    def look(depsgraph: Any) -> Snapshot:
        seen = Snapshot()
        for role, obj in singles.items():  # some are not listed below: hidden ones, and instancers that are not shown
            seen.matrices[role] = numbers(obj.evaluated_get(depsgraph).matrix_world)
        for instance in depsgraph.object_instances:
            obj = instance.object
            if not instance.is_instance:
                for role in [r for r, single in singles.items() if single == obj.original]:
                    seen.matrices[role] = numbers(instance.matrix_world)
            if not instance.show_self or not isinstance(obj.data, bpy.types.Mesh):
                continue  # a curve or text is listed again, as the mesh made of it
            vertices, triangles, slots = _mesh_of(obj)
            if len(vertices):
                owner = (instance.parent if instance.is_instance else obj).original
                matrix = numbers(instance.matrix_world)
                kinds = {kind for slot in obj.material_slots for kind in nodes.kinds(slot.material)}
                air, opaque = kinds == {nodes.VOLUME}, not kinds & _THROUGH
                materials = tuple(slot.material and slot.material.original for slot in obj.material_slots) or (None,)
                painted = materials, np.minimum(slots, len(materials) - 1)
                surface = owner, obj.name, instance.is_instance, matrix, vertices, triangles
                seen.shapes.append(Shape(*surface, air, opaque, *painted))
        return seen

    return as_rendered(scene, look)


def _mesh_of(evaluated: bpy.types.Object) -> tuple[Array, Any, Any]:
    """Vertices (n, 3) and triangles (m, 3) of an evaluated object, in its own frame, and their material slots."""
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    slots = np.empty(len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("material_index", slots)
    evaluated.to_mesh_clear()
    return vertices.reshape(-1, 3).astype(np.float64), triangles.reshape(-1, 3), slots


def pose_of(target: bpy.types.Object, matrix: Matrix) -> tuple[mathutils.Vector, Quaternion, mathutils.Vector]:
    """Return the place, turn and scale that a transform to the world means as a pose of the target.

    A matrix does not say which of its axes negative scales belong to: without a parent, the object does.
    """
    place, turn, scale = matrix.decompose()
    if target.parent is None:
        own = [_sign(s) * _sign(d) for s, d in zip(target.scale, target.delta_scale, strict=True)]
        flips = [o * _sign(s) for o, s in zip(own, scale, strict=True)]
        turn = turn @ Matrix.Diagonal(flips).to_quaternion()  # of none or two axes: both are as mirrored
        scale = mathutils.Vector([f * s for f, s in zip(flips, scale, strict=True)])
    return place, turn, scale


def target_shape(scene: bpy.types.Scene, seen: Snapshot | None = None) -> tuple[Array, Any]:
    """Return the mesh of the target and its children.

    Parameters
    ----------
    scene : bpy.types.Scene
    seen : Snapshot, optional
        Snapshot of the scene; taken if not given.

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
    place, turn, scale = pose_of(target, Matrix(seen.matrices["target"].tolist()))
    to_target = Matrix.LocRotScale(place, turn, None).inverted()
    points, faces, count = [], [], 0
    for shape in seen.of(parts):
        if shape.owner == target and not shape.instance:
            points.append(shape.vertices * np.asarray(scale, dtype=np.float64))
        else:
            matrix = numbers(to_target @ Matrix(shape.matrix.tolist()))
            points.append(shape.vertices @ matrix[:3, :3].T + matrix[:3, 3])
        faces.append(shape.triangles + count)
        count += len(shape.vertices)
    if not count:
        hidden = unseen(scene, target)
        problem = f"{hidden}; show it" if hidden else "has no surface to reflect light"
        raise NlosError(f"{file_name()}: the target {target.name!r} {problem}")
    return np.concatenate(points), np.concatenate(faces)


def hull(scene: bpy.types.Scene, seen: Snapshot | None = None) -> Array:
    """Return the vertices of the target and its children; see `target_shape`."""
    return target_shape(scene, seen)[0]


def has_surface(objects: Collection[bpy.types.Object]) -> bool:
    """Whether any of the objects has a surface after modifiers, or shows instances that have."""
    if any(len(evaluated_vertices(obj)) for obj in objects):
        return True
    return any(
        instance.is_instance and instance.parent.original in objects and len(_vertices(instance.object))
        for instance in bpy.context.evaluated_depsgraph_get().object_instances
    )


def evaluated_vertices(obj: bpy.types.Object) -> Array:
    """Return an object's vertices after modifiers, in its own frame, (n, 3); empty if it has no surface."""
    return _vertices(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))


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


def points_of(shapes: Sequence[Shape]) -> Array:
    """Return the vertices of surfaces in the world, (n, 3), metres."""
    points: Array = np.concatenate([np.empty((0, 3)), *(shape.placed for shape in shapes)])
    return points


def box_of(scene: bpy.types.Scene, objects: list[bpy.types.Object], seen: Snapshot) -> tuple[Array, Array]:
    """Bounding box of rendered objects in the world, two arrays of shape (3,)."""
    points = points_of(seen.of(objects))
    if not len(points):
        raise NlosError(f"{file_name()}: {objects[0].name!r} {unseen(scene, objects[0]) or 'has no surface'}")
    return points.min(axis=0), points.max(axis=0)


def view(scene: bpy.types.Scene, camera: bpy.types.Object, place: Array | None = None) -> tuple[Array, Array]:
    """Return where the rays through a picture's corners start and where they meet the wall, (4, 3) each.

    Parameters
    ----------
    scene : bpy.types.Scene
        Must have the resolution of the pictures.
    camera : bpy.types.Object
    place : ndarray of shape (4, 4), optional
        Transform of the camera to the world; the viewport's if not given.

    Raises
    ------
    NlosError
        The camera is neither perspective nor orthographic, or does not look at the wall.
    """
    starts, ways = corner_rays(scene, camera, place)
    if camera.data.type == "ORTHO" and (ways[:, 1] < 0.0).all() and (starts[:, 1] <= 0.0).any():
        raise NlosError(
            f"{file_name()}: the camera {camera.name!r} is orthographic, and part of its picture starts behind the "
            "relay wall (the plane y = 0); move it away from the wall, or lower its Orthographic Scale"
        )
    if (ways[:, 1] >= 0.0).any() or (starts[:, 1] <= 0.0).any():
        raise NlosError(
            f"{file_name()}: the camera {camera.name!r} does not look at the relay wall (the plane y = 0)"
        )
    # In single precision, as scenes have always been described: data sets go by these figures to the last digit.
    rays = zip(map(mathutils.Vector, starts), map(mathutils.Vector, ways), strict=True)
    corners = [start - way * (start.y / way.y) for start, way in rays]
    return starts, np.array(corners, dtype=np.float64)


def corner_rays(scene: bpy.types.Scene, camera: bpy.types.Object, place: Array | None = None) -> tuple[Array, Array]:
    """Return where the rays through a picture's corners start and which way they go, (4, 3) each; see `view`."""
    if camera.type != "CAMERA" or camera.data.type not in ("PERSP", "ORTHO"):
        raise NlosError(f"{file_name()}: the camera {camera.name!r} must be a perspective or orthographic camera")
    matrix = camera.matrix_world if place is None else Matrix(place.tolist())
    # Blender ignores the scale of cameras.
    matrix = Matrix.LocRotScale(*matrix.decompose()[:2], mathutils.Vector(map(_sign, matrix.to_scale())))
    starts, ways = [], []
    for corner in camera.data.view_frame(scene=scene):
        parallel = camera.data.type == "ORTHO"
        start = matrix @ mathutils.Vector((corner.x, corner.y, 0.0)) if parallel else matrix.translation
        starts.append(start)
        ways.append(matrix @ corner - start)
    return np.array(starts, dtype=np.float64), np.array(ways, dtype=np.float64)


def _sign(value: float) -> float:
    return math.copysign(1.0, value)
