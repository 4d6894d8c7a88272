"""Evaluated Blender scene -> what an engine needs of it, in plain arrays; says what it could not honour."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from generator import spec, stage
from generator.spec import Array, NlosError, rotation_matrix
from generator.transport.world import AmbientLight, LitPatch, Mesh, Sphere, Watched, World

MAX_ORDER = 3
"""The most reflections that `surfel` knows."""

_RIM = 1.0 - 1e-3
"""Look just inside the cone: its very edge may graze whatever the lit patch ends at."""
_EDGE = 1e-4
"""Look just inside the picture, in its own width: it may end where the wall ends."""
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Of a picture: top left, top right, bottom right, bottom left."""
_FLAT = 1e-5
"""A surface is plane if it leaves its plane by less, in units of its own size."""
_SMOOTH = 1e-3
"""Normals that lean by more than this many radians from their face's show in the shading."""
_SHADE = 1e-6
"""Colours that differ by no more are the same."""
_SPHERE_FACES = 80
_SPHERE_ROUND = 1e-3
_NOT_MESH = {
    "CURVES": "hair curves",
    "POINTCLOUD": "a point cloud",
    "VOLUME": "a volume",
    "GPENCIL": "grease pencil",
    "GREASEPENCIL": "grease pencil",
}


@dataclass(frozen=True)
class Survey:
    """What a scene holds for each engine, and what each cannot honour: a phrase each that names the object.

    Attributes
    ----------
    scene : str
        Its file.
    never : list of str
        Why it cannot be swept by any engine.
    patch : LitPatch or None
        None if `patch` cannot honour something.
    patch_reasons : list of str
        What `patch` cannot, besides.
    world : World or None
        What `surfel` needs of it; None if it cannot honour something.
    surfel_reasons : list of str
        What `surfel` cannot, besides; all of `patch_reasons` among it.
    """

    scene: str
    never: list[str]
    patch: LitPatch | None
    patch_reasons: list[str]
    world: World | None
    surfel_reasons: list[str]

    def reasons(self, engine: str) -> list[str]:
        """Return what an engine cannot honour."""
        more = {"path": [], "patch": self.patch_reasons, "surfel": self.surfel_reasons}
        return list(dict.fromkeys([*self.never, *more[engine]]))

    def check(self, engine: str) -> None:
        """Raise NlosError, naming everything and the engine that can, if an engine cannot honour the scene."""
        if self.never:
            raise NlosError(f"{self.scene}: cannot be swept: {'; '.join(self.never)}")
        if reasons := self.reasons(engine):
            instead = "path" if self.patch_reasons else "patch"
            what = ", nor that ".join(reasons)
            raise NlosError(f"{self.scene}: the engine {engine!r} cannot honour that {what}; use --engine {instead}")


def survey(scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None, ambient: bool = False) -> Survey:
    """Read a scene as a render sees it, for all engines.

    Parameters
    ----------
    scene : bpy.types.Scene
        The target is moved on the way, and put back.
    resolution : (int, int), optional
        Of the pictures, width and height; the scene's own if not given.
    ambient : bool
        Whether `surfel` may follow uniform ambient light, which is right to a few per cent only; else it is a reason.

    Raises
    ------
    NlosError
        A role is missing or played twice, or the scene cannot be read.
    """
    spot, camera, target = (stage.find(scene, role) for role in ("spot", "camera", "target"))
    with stage.Overrides() as overrides:
        size = stage.shape_pictures(scene, resolution, overrides)
        with stage.put_back(scene):
            reading, never = _at_rest(scene, target)
        patch, patch_reasons = _lit_patch(scene, reading)
        watched, view_reasons = _watched(scene, reading, size)
    reasons = [*patch_reasons, *view_reasons, *reading.reasons]
    sky = None
    if reading.sky is not None and ambient:
        walls = [s for s in reading.surfaces if s.role == "relay_wall"]
        sky = AmbientLight(reading.sky, _mesh(walls)) if walls else None
    elif reading.sky is not None:
        reasons.append(f"the world {scene.world.name!r} gives ambient light")
    if patch is not None and watched is not None and patch.normal @ watched.normal < 0:
        reasons.append(f"the camera {camera.name!r} and the spot {spot.name!r} stand on opposite sides of the wall")
    order = stage.reflection_order(scene)
    if order > MAX_ORDER:
        reasons.append(f"the reflection order is {order}, and surfel stops at {MAX_ORDER}")
    origin = reading.places["target"][:3, 3]
    parts = [s for s in reading.surfaces if s.role == "target"]
    spheres = [_sphere(part, origin) for part in parts]
    bodies = [sphere or _mesh([part], origin) for sphere, part in zip(spheres, parts, strict=True)]
    named = _room(reading)
    room = [_mesh([s for s in reading.surfaces if s.role == "room" and s.name == name]) for name in named]
    for surface in reading.surfaces:
        reasons += surface.flaws
    bent = [s for s in reading.surfaces if s.smooth and s.role != "target"]
    bent += [part for sphere, part in zip(spheres, parts, strict=True) if part.smooth and sphere is None]
    reasons += [f"{s.label} is shaded smooth, so that it reflects as if it were curved" for s in bent]
    if why := stage.unseen(scene, target):
        reasons.append(f"the target {target.name!r} {why}")
    elif not bodies:
        reasons.append(f"the target {target.name!r} has no surface to reflect light")
    whole = None
    if not (never or reasons) and patch is not None and watched is not None:
        whole = World(patch=patch, watched=watched, target=tuple(bodies), room=tuple(room), order=order, ambient=sky)
    return Survey(
        scene=bpy.data.filepath or "scene",
        never=list(dict.fromkeys(never)),
        patch=None if patch_reasons else patch,
        patch_reasons=list(dict.fromkeys(patch_reasons)),
        world=whole,
        surfel_reasons=list(dict.fromkeys(reasons)),
    )


def lit_patch(scene: bpy.types.Scene) -> LitPatch:
    """Return the lit patch of a scene, or say why it has none in closed form.

    Raises
    ------
    NlosError
        `Survey.check` of the engine `patch`.
    """
    found = survey(scene)
    found.check("patch")
    assert found.patch is not None
    return found.patch


def surfel_world(scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None) -> World:
    """Return what the engine `surfel` needs of a scene, ambient light too, or say why it cannot render it.

    Raises
    ------
    NlosError
        `Survey.check` of the engine `surfel`.
    """
    found = survey(scene, resolution=resolution, ambient=True)
    found.check("surfel")
    assert found.world is not None
    return found.world


def world(
    scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None, ambient: bool = False
) -> tuple[World | None, list[str]]:
    """Return what the engine `surfel` needs of a scene, or None, and what it cannot honour; see `survey`."""
    found = survey(scene, resolution=resolution, ambient=ambient)
    return found.world, found.reasons("surfel")


def room_names(scene: bpy.types.Scene) -> list[str]:
    """Return the names of the objects that `world` calls the room, in its order."""
    with stage.Overrides(), stage.put_back(scene):
        return _room(_at_rest(scene, stage.find(scene, "target"))[0])


def _room(reading: Any) -> list[str]:
    return list(dict.fromkeys(s.name for s in reading.surfaces if s.role == "room"))


# --------------------------------------------------------------------------------------------------------------------
# Reading the scene as a render sees it
# --------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Surface:
    """A rendered surface: its triangles (n, 3, 3) in the world, metres, with albedos (n, 3)."""

    name: str
    label: str
    role: str
    triangles: Array
    albedo: Array
    closed: bool
    smooth: bool
    faces: int
    seen: bool
    flaws: tuple[str, ...]


@dataclass
class _Reading:
    """All rendered surfaces, where the objects with a role stand (4 x 4 matrices), what else there is, and the
    radiance (3,) of a world that shines alike from everywhere, if it does."""

    surfaces: list[_Surface] = field(default_factory=list)
    places: dict[str, Array] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)
    sky: Array | None = None


def _read(scene: bpy.types.Scene) -> _Reading:
    parts = stage.target_parts(scene)
    roles = {stage.find(scene, role): role for role in ("relay_wall", "spot", "camera", "target")}
    roles |= dict.fromkeys(parts, "target")

    def look(depsgraph: Any) -> _Reading:
        reading = _Reading(reasons=_layer_reasons(scene, depsgraph))
        reading.sky, more = _sky(depsgraph.scene.world)
        reading.reasons += more
        layer = scene.view_layers[depsgraph.view_layer.name]
        known: dict[int, _Shape] = {}
        for instance in depsgraph.object_instances:
            _read_instance(instance, roles, parts[0], layer, reading, known)
        return reading

    return stage.as_rendered(scene, look)


def _read_instance(
    instance: Any,
    roles: dict[bpy.types.Object, str],
    target: bpy.types.Object,
    layer: bpy.types.ViewLayer,
    reading: _Reading,
    known: dict[int, _Shape],
) -> None:
    obj = instance.object
    owner = (instance.parent if instance.is_instance else obj).original
    role = roles.get(owner, "room")
    matrix = stage.numbers(instance.matrix_world)
    if not instance.is_instance and obj.original in roles:
        key = role if role != "target" or obj.original == target else obj.name
        reading.places[key] = matrix
    if obj.type == "LIGHT":
        if (instance.is_instance or role != "spot") and obj.data.energy != 0.0:
            reading.reasons.append(f"the lamp {obj.name!r} shines too")
        return
    hair = [s for s in obj.particle_systems if s.settings.type == "HAIR" and s.settings.render_type == "PATH"]
    if hair and instance.show_particles:
        reading.reasons.append(f"{obj.name!r} carries hair")
    if not instance.show_self:
        return
    if obj.type in _NOT_MESH:
        reading.reasons.append(f"{obj.name!r} is {_NOT_MESH[obj.type]}, and surfel knows only faces")
        return
    if not isinstance(obj.data, bpy.types.Mesh):
        return  # a curve or text comes a second time, as the mesh made of it
    pointer = obj.data.as_pointer()
    if pointer not in known:
        known[pointer] = _shape(obj)
    shape = known[pointer]
    if not len(shape.corners):
        return
    label = f"{obj.name!r}"
    if role == "relay_wall":
        label = f"the relay wall {label}"
    elif role == "target":
        label = f"the target {label}" if obj.original == target else f"{label}, which moves with the target,"
    triangles = shape.corners @ matrix[:3, :3].T + matrix[:3, 3]
    flaws = [*shape.flaws, *_visibility_flaws(instance, role, layer)]
    if not np.isfinite(triangles).all():
        flaws.append("has a corner that is not a finite number")
        triangles = np.nan_to_num(triangles, nan=0.0, posinf=0.0, neginf=0.0)
    reading.surfaces.append(
        _Surface(
            name=obj.name,
            label=label,
            role=role if role in ("relay_wall", "target") else "room",
            triangles=triangles,
            albedo=shape.albedo,
            closed=shape.closed,
            smooth=shape.smooth,
            faces=shape.faces,
            seen=obj.visible_camera,
            flaws=tuple(f"{label} {flaw}" for flaw in flaws),
        )
    )


@dataclass(frozen=True)
class _Shape:
    """The mesh of an object in its own frame; many instances may share it."""

    corners: Array
    albedo: Array
    closed: bool
    smooth: bool
    faces: int
    flaws: tuple[str, ...]


def _shape(obj: Any) -> _Shape:
    mesh = obj.to_mesh()
    try:
        mesh.calc_loop_triangles()
        vertices = _values(mesh.vertices, "co", 3, np.float32)
        triangles = _values(mesh.loop_triangles, "vertices", 3, np.int32)
        corners = vertices[triangles].astype(np.float64)
        polygon = _values(mesh.loop_triangles, "polygon_index", 1, np.int32)[:, 0]
        slot = _values(mesh.polygons, "material_index", 1, np.int32)[:, 0][polygon]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        solid = sides.any(axis=1)  # what has no area neither reflects nor hides anything
        edges = np.bincount(_values(mesh.loops, "edge_index", 1, np.int32)[:, 0])
        colours, flaws = _colours(obj, slot[solid])
        return _Shape(
            corners=corners[solid],
            albedo=colours,
            closed=bool((edges[edges > 0] == 2).all()),
            smooth=is_smooth(mesh),
            faces=len(mesh.polygons),
            flaws=flaws,
        )
    finally:
        obj.to_mesh_clear()


def _values(collection: Any, name: str, width: int, kind: type) -> Any:
    values: Any = np.empty(len(collection) * width, dtype=kind)
    collection.foreach_get(name, values)
    return values.reshape(-1, width)


def is_smooth(mesh: Any) -> bool:
    """Whether any corner's normal leans from its face's: shading that is set smooth may well be flat all the same."""
    if not len(mesh.polygons):
        return False
    shading = _values(mesh.corner_normals, "vector", 3, np.float32)
    faces = np.repeat(
        _values(mesh.polygons, "normal", 3, np.float32),
        _values(mesh.polygons, "loop_total", 1, np.int32)[:, 0],
        axis=0,
    )
    lean = np.linalg.norm(np.cross(shading, faces), axis=1)
    area = np.repeat(
        _values(mesh.polygons, "area", 1, np.float32)[:, 0], _values(mesh.polygons, "loop_total", 1, np.int32)[:, 0]
    )
    return bool((((lean > _SMOOTH) | ((shading * faces).sum(axis=1) < 0)) & (area > 0)).any())


def _colours(obj: Any, slots: Any) -> tuple[Array, tuple[str, ...]]:
    """Return the albedo (n, 3) of faces with those material slots, and what is amiss with their materials."""
    materials = [slot.material for slot in obj.material_slots] or [None]
    slots = np.clip(slots, 0, len(materials) - 1)  # as Cycles does
    table = np.zeros((len(materials), 3))
    flaws = []
    for index in np.unique(slots):
        material = materials[index]
        colour = None if material is None else stage.material_colour(material)
        if colour is None:
            flaws.append(_material_flaw(material))
        elif min(colour) < 0.0 or max(colour) > 1.0:
            flaws.append(f"has a material ({material.name!r}) whose colour is not between 0 and 1")
        else:
            table[index] = colour
    albedo: Array = table[slots]
    return albedo, tuple(dict.fromkeys(flaws))


def _material_flaw(material: Any) -> str:
    if material is None:
        return "has no material, so that Cycles takes one of its own, which is glossy"
    output = stage.material_output(material)
    if output is not None and output.inputs["Volume"].is_linked:
        return "has a material that fills it with a volume"
    if output is not None and output.inputs["Displacement"].is_linked:
        return "has a material that displaces it"
    if stage.may_glow(material):
        return "has a material that may give light of its own"
    return "has a material that is not one constant diffuse colour"


def _visibility_flaws(instance: Any, role: str, layer: bpy.types.ViewLayer) -> list[str]:
    objects = [instance.object] + ([instance.parent] if instance.is_instance else [])
    rays = {"visible_diffuse": "diffuse", "visible_shadow": "shadow"}
    if role == "relay_wall":
        rays["visible_camera"] = "camera"
    flaws = [f"is not visible to {word} rays" for n, word in rays.items() if not all(getattr(o, n) for o in objects)]
    originals = [o.original for o in objects]
    if any(o.is_holdout or o.holdout_get(view_layer=layer) for o in originals):
        flaws.append("is a holdout")
    if any(o.indirect_only_get(view_layer=layer) for o in originals):
        flaws.append("is in a collection that is seen indirectly only")
    if any(o.is_shadow_catcher for o in originals):
        flaws.append("is a shadow catcher")
    return flaws


def _layer_reasons(scene: bpy.types.Scene, depsgraph: Any) -> list[str]:
    """What the world and the view layers do to a picture that `surfel` does not."""
    reasons = []
    rendered = [layer for layer in scene.view_layers if layer.use]
    if len(rendered) > 1:
        reasons.append(f"{len(rendered)} view layers are rendered, not one")
    for layer in rendered:
        if layer.material_override is not None:
            reasons.append(f"the view layer {layer.name!r} puts one material in place of all")
        if not layer.use_solid:
            reasons.append(f"the view layer {layer.name!r} leaves out solid faces")
        if getattr(layer, "world_override", None) is not None:
            reasons.append(f"the view layer {layer.name!r} has a world of its own")
    return reasons


def _sky(world: Any) -> tuple[Array | None, list[str]]:
    """Radiance (3,), W/m^2/sr, of a world that shines alike from everywhere, if it shines; what else is amiss."""
    if world is None:
        return None, []
    tree, reasons = world.node_tree, []
    if bpy.app.version < (5, 0) and not world.use_nodes:
        tree = None
    if tree is None:
        return _lit(world.color), []
    output = next((n for n in tree.nodes if n.type == "OUTPUT_WORLD" and n.is_active_output), None)
    if output is None:
        return None, []
    if output.inputs["Volume"].is_linked:
        reasons.append(f"the world {world.name!r} is filled with a volume")
    if not output.inputs["Surface"].is_linked:
        return None, reasons
    shader = output.inputs["Surface"].links[0].from_node
    if shader.type == "BACKGROUND":
        colour, strength = shader.inputs["Color"], shader.inputs["Strength"]
        if not strength.is_linked and (strength.default_value == 0.0 or not colour.is_linked):
            return _lit(strength.default_value * np.array(colour.default_value[:3])), reasons
        if not colour.is_linked and not any(colour.default_value[:3]):
            return None, reasons
    return None, [*reasons, f"the world {world.name!r} gives ambient light that is not one constant radiance"]


def _lit(radiance: Any) -> Array | None:
    values = np.array(radiance, dtype=np.float64)[:3]
    return values if values.any() else None


def _mesh(surfaces: Sequence[_Surface], origin: Any = 0.0) -> Mesh:
    return Mesh(
        triangles=np.concatenate([s.triangles for s in surfaces]) - origin,
        albedo=np.concatenate([s.albedo for s in surfaces]),
    )


def _sphere(surface: _Surface, origin: Array) -> Sphere | None:
    """Return the sphere that a finely tessellated ball stands for: the one with the mesh's own area; else None."""
    if not surface.closed or surface.faces < _SPHERE_FACES or np.ptp(surface.albedo, axis=0).any():
        return None
    corners = np.unique((surface.triangles - origin).reshape(-1, 3), axis=0)
    middle = corners.mean(axis=0)
    around = corners - middle
    squared = (around**2).sum(axis=1)
    # |x - c|^2 = r^2 is linear in c and in r^2 - c^2.
    system = np.column_stack([2.0 * around, np.full(len(around), math.sqrt(squared.max()))])
    shift = np.linalg.lstsq(system, squared, rcond=None)[0][:3]
    centre = middle + shift
    distances = np.linalg.norm(around - shift, axis=1)
    mean = float(distances.mean())
    if np.abs(distances - mean).max() > _SPHERE_ROUND * mean:
        return None
    local = surface.triangles - origin - centre
    sides = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    doubled = np.linalg.norm(sides, axis=1)
    # A ball cut off flat has its corners on the sphere too; its faces are not near it.
    if (np.abs((sides * local[:, 0]).sum(axis=1)) < 0.85 * mean * doubled).any():
        return None
    radius = math.sqrt(doubled.sum() / 2.0 / (4.0 * math.pi))
    if not 0.85 * mean < radius < (1.0 + _SPHERE_ROUND) * mean:  # two balls in one
        return None
    return Sphere(centre=centre, radius=radius, albedo=surface.albedo[0])


def _at_rest(scene: bpy.types.Scene, target: bpy.types.Object) -> tuple[_Reading, list[str]]:
    """Read the scene with the target unrotated where it is; find out what else changes when it moves.

    The second is why no engine can sweep the scene: a data set's poses would not be those of its pictures, or its
    background not the one that they have.
    """
    if stage.unseen(scene, target):  # where it goes cannot be seen
        reading = _read(scene)
        reading.places.setdefault("target", stage.numbers(target.matrix_world))
        return reading, []
    try:
        place = stage.snapshot(scene).matrices["target"][:3, 3]
        stage.move_target(scene, _vector(place), (0.0, 0.0, 0.0))
        reading = _read(scene)
        parts = [s for s in reading.surfaces if s.role == "target"]
        corner = np.concatenate([np.zeros((0, 3)), *(s.triangles.reshape(-1, 3) for s in parts)])
        size = float(np.ptp(corner, axis=0).max()) if len(corner) else 1.0
        moved_to = place + size * np.array([0.31, 0.17, 0.23])
        turn = (40.0, 25.0, 70.0)
        stage.move_target(scene, _vector(moved_to), turn)
        moved = _read(scene)
    except NlosError as error:
        reading = _read(scene)
        reading.places.setdefault("target", stage.numbers(target.matrix_world))
        return reading, [str(error).removeprefix(f"{bpy.data.filepath or 'scene'}: ")]
    before = reading.places.setdefault("target", stage.numbers(target.matrix_world))
    after = moved.places.get("target", stage.numbers(target.matrix_world))
    slack = 1e-4 * size + 1e-6 * float(np.abs(moved_to).max())
    matrix = rotation_matrix(turn)
    # An animation has its say only when a render starts: where the target was put is not where it is.
    stays = np.abs([before[:3, 3] - place, after[:3, 3] - moved_to]).max() > slack
    turned = after[:3, :3] - matrix @ before[:3, :3]
    if stays or np.abs(turned).max() > 1e-4 * np.abs(before[:3, :3]).max():
        return reading, [stage.held(target)]
    carried = [replace(s, triangles=(s.triangles - before[:3, 3]) @ matrix.T + after[:3, 3]) for s in parts]
    reading.reasons += [
        f"{label} changes its shape or colour with where it stands"
        for label in _changed(carried, [s for s in moved.surfaces if s.role == "target"], slack)
    ]
    others, still = ([s for s in r.surfaces if s.role != "target"] for r in (reading, moved))
    never = [
        f"{label} changes when the target moves, and is not one of its children"
        for label in _changed(others, still, 1e-6 * size)
    ]
    for role in ("camera", "spot"):
        if role in moved.places and np.abs(reading.places[role] - moved.places[role]).max() > 1e-6:
            never.append(f"the {role} {stage.find(scene, role).name!r} moves when the target does")
    return reading, never


def _changed(before: Sequence[_Surface], after: Sequence[_Surface], slack: float) -> list[str]:
    """Return the labels of surfaces that are not, corner by corner, what they were, in shape and colour."""
    left: dict[str, list[_Surface]] = {}
    for surface in after:
        left.setdefault(surface.name, []).append(surface)
    labels = []
    for surface in before:
        now = left[surface.name].pop(0) if left.get(surface.name) else None
        if now is None or not (
            _alike(now.triangles, surface.triangles, slack) and _alike(now.albedo, surface.albedo, _SHADE)
        ):
            labels.append(surface.label)
    return [*labels, *(surface.label for rest in left.values() for surface in rest)]


def _alike(one: Array, other: Array, slack: float) -> bool:
    return one.shape == other.shape and float(np.abs(one - other).max(initial=0.0)) <= slack


def _vector(values: Array) -> spec.Vector:
    return (float(values[0]), float(values[1]), float(values[2]))


# --------------------------------------------------------------------------------------------------------------------
# The lit patch
# --------------------------------------------------------------------------------------------------------------------


def _lit_patch(scene: bpy.types.Scene, reading: _Reading) -> tuple[LitPatch | None, list[str]]:
    lamp, wall = stage.find(scene, "spot"), stage.find(scene, "relay_wall")
    light = lamp.data
    if lamp.type != "LIGHT" or light.type != "SPOT":
        return None, [f"the spot {lamp.name!r} is not a spot lamp"]
    reasons = _lamp_reasons(lamp, stage.reflection_order(scene))
    if "spot" not in reading.places:
        reasons.append(f"the spot {lamp.name!r} is hidden from renders")
    colour = stage.diffuse_colour(wall)
    if colour is None:
        reasons.append(f"the relay wall {wall.name!r} has a material that is not one constant diffuse colour")
    surfaces = [s for s in reading.surfaces if s.role != "target"]
    matrix = stage.numbers(lamp.matrix_world)
    origin, axis = matrix[:3, 3], -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    half = light.spot_size / 2.0
    hit, point, normal = _first_hit(surfaces, origin, axis)
    if hit is None or hit.role != "relay_wall":
        return None, [*reasons, _blocked(lamp, wall, hit)]
    if normal @ axis > 0:
        normal = -normal
    height = float((origin - point) @ normal)
    tilt = math.acos(min(1.0, float(-axis @ normal)))
    if tilt + half >= math.radians(89.0):
        return None, [*reasons, f"the spot {lamp.name!r} grazes the wall, so that its patch has no edge"]
    along = axis + normal * math.cos(tilt)
    along = along / np.linalg.norm(along) if tilt > 1e-6 else _perpendicular(normal)
    near, far = height * math.tan(tilt - half), height * math.tan(tilt + half)
    middle, major = (near + far) / 2.0, (far - near) / 2.0
    reach = (middle * math.sin(tilt) + height * math.cos(tilt)) / math.cos(half)
    minor = math.sqrt(reach**2 - middle**2 - height**2)
    blend = float(light.spot_blend)
    patch = LitPatch(
        centre=origin - height * normal + middle * along,
        major=major * along,
        minor=minor * np.cross(normal, along),
        normal=normal,
        lamp=origin,
        axis=axis,
        height=height,
        intensity=stage.numbers(light.color)
        * (light.energy * 2.0 ** getattr(light, "exposure", 0.0) / (4.0 * math.pi)),
        albedo=np.asarray(colour or (0.0, 0.0, 0.0)),
        cos_outer=math.cos(half),
        cos_width=(1.0 - math.cos(half)) * blend,
    )
    turns = np.arange(64)[:, None] * (2.0 * math.pi / 64)
    rim = patch.centre + _RIM * (np.cos(turns) * patch.major + np.sin(turns) * patch.minor)
    apex = np.append(origin, 1.0)
    sides = _pyramid(rim, apex)
    before = [*sides, _Plane(normal, float(normal @ point) + 1e-4 * height)]
    blocking = [s for s in surfaces if _areas(s.triangles, before).sum() > _NOTHING * major * minor]
    reasons += [_blocked(lamp, wall, s) for s in blocking]
    if not blocking and not _covered(surfaces, sides, point, normal, rim, 1e-4 * height):
        reasons.append(_blocked(lamp, wall, None))
    return (None if reasons else patch), list(dict.fromkeys(reasons))


def _lamp_reasons(lamp: bpy.types.Object, order: int) -> list[str]:
    """What is special about a spot lamp."""
    light, name = lamp.data, f"the spot {lamp.name!r}"
    reasons = []
    if light.shadow_soft_size > 0:
        reasons.append(f"{name} has a radius of {light.shadow_soft_size:g} m, not 0")
    # From Blender 5.2 on every lamp has nodes, and to ask whether they are used is deprecated.
    used = bpy.app.version >= (5, 2) or light.use_nodes
    if used and light.node_tree and _has_own_nodes(light.node_tree):
        reasons.append(f"{name} has shader nodes of its own")
    if getattr(light, "use_temperature", False):
        reasons.append(f"{name} takes its colour from a temperature")
    if not getattr(light, "normalize", True):
        reasons.append(f"{name} has a power that is not normalised")
    scale = stage.numbers(lamp.matrix_world.to_scale())
    if np.ptp(np.abs(scale)) > 1e-5 * np.abs(scale).max():
        reasons.append(f"{name} is scaled unevenly, so that its cone is not round")
    if not light.use_shadow or not getattr(light.cycles, "cast_shadow", True):
        reasons.append(f"{name} casts no shadows")
    if light.cycles.max_bounces < order - 1:
        reasons.append(f"{name} has a limit of bounces of its own ({light.cycles.max_bounces})")
    if not lamp.visible_diffuse:
        reasons.append(f"{name} is not visible to diffuse rays")
    linking = getattr(lamp, "light_linking", None)
    if linking is not None and (linking.receiver_collection or linking.blocker_collection):
        reasons.append(f"{name} is linked to some objects only (light linking)")
    return reasons


def _blocked(lamp: bpy.types.Object, wall: bpy.types.Object, hit: _Surface | None) -> str:
    if hit is None or hit.role == "relay_wall":
        return f"part of the cone of the spot {lamp.name!r} misses the plane of the relay wall {wall.name!r}"
    return f"{hit.name!r} stands in the cone of the spot {lamp.name!r}, before the relay wall"


def _has_own_nodes(tree: bpy.types.NodeTree) -> bool:
    """Whether a lamp's node tree is other than the one every lamp starts with: white emission of strength 1."""
    if {n.type for n in tree.nodes} - {"EMISSION", "OUTPUT_LIGHT"}:
        return True
    for node in tree.nodes:
        if node.type == "EMISSION":
            colour, strength = node.inputs["Color"], node.inputs["Strength"]
            if colour.is_linked or strength.is_linked or strength.default_value != 1.0:
                return True
            if any(c != 1.0 for c in colour.default_value):
                return True
    return False


def _perpendicular(normal: Array) -> Array:
    other = np.eye(3)[int(np.argmin(np.abs(normal)))]
    across = np.cross(normal, other)
    unit: Array = across / np.linalg.norm(across)
    return unit


# --------------------------------------------------------------------------------------------------------------------
# The watched patch
# --------------------------------------------------------------------------------------------------------------------


def _watched(
    scene: bpy.types.Scene, reading: _Reading, resolution: tuple[int, int]
) -> tuple[Watched | None, list[str]]:
    camera, wall = stage.find(scene, "camera"), stage.find(scene, "relay_wall")
    name = f"the camera {camera.name!r}"
    if camera.type != "CAMERA" or camera.data.type not in ("PERSP", "ORTHO"):
        return None, [f"{name} is neither perspective nor orthographic"]
    lens = camera.data
    reasons = []
    if lens.dof.use_dof:
        reasons.append(f"{name} has depth of field")
    surfaces = [s for s in reading.surfaces if s.role != "target"]
    walls = [s.triangles for s in surfaces if s.role == "relay_wall"]
    if not walls:
        return None, [*reasons, f"the relay wall {wall.name!r} is hidden from renders, or has no surface"]
    triangles = np.concatenate(walls)
    point, normal, uneven = _plane_of(triangles)
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    if uneven > _FLAT * size:
        return None, [*reasons, f"the relay wall {wall.name!r} is not plane"]
    matrix = stage.numbers(camera.matrix_world)
    # Cameras have no scale: Blender drops it.
    frame, eye = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0), matrix[:3, 3]
    if (eye - point) @ normal < 0:
        normal = -normal
    height = float((eye - point) @ normal)
    right_top, _, left_bottom, left_top = (
        frame @ np.asarray(c, dtype=np.float64) for c in lens.view_frame(scene=scene)
    )
    across, down = right_top - left_top, left_bottom - left_top
    forward = -frame[:, 2]
    beyond = f"{name} sees beyond the plane of the relay wall {wall.name!r}"
    # Where a ray meets the plane is homogeneous: the ray's own slope towards the wall is the last component.
    to_wall = np.zeros((4, 3))
    if lens.type == "ORTHO":
        slope = float(-forward @ normal)
        if slope <= 1e-9:
            return None, [*reasons, beyond]
        # The frame's corners lie before the camera; only where they are across its axis counts.
        start = np.column_stack([across, down, eye + left_top])
        start_height = normal @ start - np.array([0.0, 0.0, normal @ point])
        to_wall[:3] = start + np.outer(forward, start_height / slope)
        to_wall[3] = 0.0, 0.0, 1.0
        middle = to_wall[:3] @ np.array([0.5, 0.5, 1.0])
        seen_from = np.append(-forward * float((middle - eye) @ forward), 0.0)
    else:
        rays = np.column_stack([across, down, left_top])
        rays = rays / np.abs(rays).max()
        slopes = -normal @ rays
        to_wall[:3] = height * rays + np.outer(eye, slopes)
        to_wall[3] = slopes
        seen_from = np.append(eye, 1.0)
        if (np.column_stack([_CORNERS, np.ones(4)]) @ slopes <= 1e-9).any() or height <= 1e-9 * size:
            return None, [*reasons, beyond]
    watched = Watched(
        to_wall=to_wall,
        eye=seen_from,
        normal=normal,
        albedo=np.asarray(stage.diffuse_colour(wall) or (0.0, 0.0, 0.0)),
        resolution=resolution,
    )
    reach = (watched.points(_CORNERS) - eye) @ forward
    if reach.min() < lens.clip_start or reach.max() > lens.clip_end:
        reasons.append(f"{name} clips the relay wall {wall.name!r}")
    outline = watched.points(_EDGE + (1.0 - 2.0 * _EDGE) * _CORNERS)
    sides = _pyramid(outline, seen_from)
    slack = 1e-4 * float(reach.min())
    between = [
        *sides,
        _Plane(normal, float(normal @ point) + slack),
        _Plane(forward, float(forward @ eye) + lens.clip_start),
    ]
    least = _NOTHING * _area(outline)
    for surface in surfaces:
        if surface.seen and surface.role == "room" and _areas(surface.triangles, between).sum() > least:
            reasons.append(f"{surface.name!r} stands between {name} and the relay wall")
    if not _covered(surfaces, sides, point, normal, outline, slack):
        reasons.append(f"{name} sees beyond the edge of the relay wall {wall.name!r}")
    return watched, list(dict.fromkeys(reasons))


def _plane_of(triangles: Array) -> tuple[Array, Array, float]:
    """Return a point and the unit normal of the plane through triangles, and by how much they leave it."""
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    largest = sides[np.argmax((sides**2).sum(axis=1))]
    normal = (sides * np.sign(sides @ largest)[:, None]).sum(axis=0)
    normal = normal / np.linalg.norm(normal)
    corners = triangles.reshape(-1, 3)
    point = corners.mean(axis=0)
    return point, normal, float(np.abs((corners - point) @ normal).max())


# --------------------------------------------------------------------------------------------------------------------
# What is in the way: exactly, not by probing
# --------------------------------------------------------------------------------------------------------------------

_NOTHING = 1e-9
"""An area is none if it is less, in units of the outline that is looked through."""


@dataclass(frozen=True)
class _Plane:
    """The half space of points p with normal @ p >= offset; the normal has unit length."""

    normal: Array
    offset: float


def _pyramid(outline: Array, apex: Array) -> list[_Plane]:
    """Return the sides of the pyramid from an apex (homogeneous, 4) to a convex outline (n, 3), facing inwards."""
    towards = apex[:3] - apex[3] * outline
    normals = np.cross(np.roll(outline, -1, axis=0) - outline, towards)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    inside = ((outline.mean(axis=0) - outline) * normals).sum(axis=1)
    normals = normals * np.sign(inside)[:, None]
    return [_Plane(n, float(n @ corner)) for n, corner in zip(normals, outline, strict=True)]


def _areas(triangles: Array, planes: Sequence[_Plane]) -> Array:
    """Return the area of each triangle (n, 3, 3) inside all of the planes."""
    left = np.arange(len(triangles))
    whole = np.ones(len(triangles), dtype=bool)
    for plane in planes:
        over = triangles[left] @ plane.normal - plane.offset
        whole[left] &= (over >= 0.0).all(axis=1)
        left = left[(over > 0.0).any(axis=1)]
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas: Array = np.where(whole, np.linalg.norm(sides, axis=1) / 2.0, 0.0)
    for index in left[~whole[left]]:
        polygon = triangles[index]
        for plane in planes:
            polygon = _cut(polygon, plane)
        areas[index] = _area(polygon)
    return areas


def _cut(polygon: Array, plane: _Plane) -> Array:
    """Return the part (m, 3) of a convex polygon (n, 3) that lies inside a plane (Sutherland and Hodgman 1974)."""
    over = polygon @ plane.normal - plane.offset
    kept = []
    for i in range(len(polygon)):
        a, b = over[i - 1], over[i]
        if (a >= 0.0) != (b >= 0.0):
            kept.append(polygon[i - 1] + (polygon[i] - polygon[i - 1]) * (a / (a - b)))
        if b >= 0.0:
            kept.append(polygon[i])
    return np.array(kept).reshape(-1, 3)


def _area(polygon: Array) -> float:
    if len(polygon) < 3:
        return 0.0
    spokes = polygon[1:] - polygon[0]
    return float(np.linalg.norm(np.cross(spokes[:-1], spokes[1:]).sum(axis=0)) / 2.0)


def _covered(
    surfaces: Sequence[_Surface], sides: Sequence[_Plane], point: Array, normal: Array, outline: Array, slack: float
) -> bool:
    """Whether the relay wall, as far as it lies in a plane, fills an outline in that plane."""
    wall = np.concatenate([s.triangles for s in surfaces if s.role == "relay_wall"])
    flat = wall[(np.abs((wall - point) @ normal) <= slack).all(axis=1)]
    return bool(_areas(flat, sides).sum() >= (1.0 - 1e-5) * _area(outline))


def _first_hit(surfaces: Sequence[_Surface], origin: Array, way: Array) -> tuple[_Surface | None, Array, Array]:
    """First surface along a ray: which, where, and its unit normal (Moeller and Trumbore 1997)."""
    best: tuple[_Surface | None, Array, Array] = (None, np.zeros(3), np.zeros(3))
    nearest = math.inf
    for surface in surfaces:
        a = surface.triangles[:, 0] - origin
        first, second = surface.triangles[:, 1] - origin - a, surface.triangles[:, 2] - origin - a
        normals = np.cross(first, second)
        slope = normals @ way
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (normals * a).sum(axis=1) / slope
            across = np.cross(way, a)
            u, v = -(across * second).sum(axis=1) / slope, (across * first).sum(axis=1) / slope
            hits = np.flatnonzero((slope != 0) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0))
        if len(hits) and distance[hits].min() < nearest:
            index = hits[np.argmin(distance[hits])]
            nearest = float(distance[index])
            best = surface, origin + nearest * way, normals[index] / np.linalg.norm(normals[index])
    return best
