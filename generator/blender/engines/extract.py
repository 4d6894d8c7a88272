"""Evaluated Blender scene -> what an engine needs of it, in plain arrays; says what it could not honour."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from generator.blender.engines import coincident
from generator.blender.scene import nodes, stage
from generator.model import spec
from generator.model.spec import Array, NlosError, rotation_matrix
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
_COARSE = 0.1
"""Radians, likewise, from which it shows in the shadow as well: of an icosphere of 320 faces and less."""
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
    lights : list of Light
        All that give light; the spot too.
    kinds : frozenset of str
        How the materials of all that is rendered send light on (`nodes.kinds`).
    """

    scene: str
    never: list[str]
    patch: LitPatch | None
    patch_reasons: list[str]
    world: World | None
    surfel_reasons: list[str]
    lights: list[Light]
    kinds: frozenset[str]

    @property
    def alone(self) -> bool:
        """Whether nothing but the spot gives light."""
        return not other_lights(self.lights)

    @property
    def mirrors(self) -> bool:
        """Whether anything but a diffuse surface reflects, so that rays must be able to meet a lamp by chance."""
        return bool(self.kinds - {nodes.DIFFUSE, nodes.TRANSPARENT})

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
        [name] = [light.name for light in reading.lights if light.kind == "WORLD"]
        reasons.append(f"the world {name!r} gives ambient light")
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
    reasons += _coincident(reading, patch)
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
        lights=reading.lights,
        kinds=frozenset().union(*reading.kinds.values()),
    )


def _coincident(reading: _Reading, patch: LitPatch | None) -> list[str]:
    """Name surfaces that lie on one another, of which Cycles sees one and a sum over surfaces both."""
    reasons = []
    moving = [s for s in reading.surfaces if s.role == "target"]
    still = [s for s in reading.surfaces if s.role != "target"]
    for together in (moving, still):
        if not together:
            continue
        triangles = np.concatenate([s.triangles for s in together])
        owner = np.repeat(np.arange(len(together)), [len(s.triangles) for s in together])
        pairs = coincident.overlapping(triangles)
        if together is still and patch is not None:
            sealed = np.concatenate([_sealed(s, patch.centre) for s in still])
            pairs = pairs[~sealed[pairs].any(axis=1)]
        for a, b in np.unique(owner[pairs], axis=0):
            one, other = together[a], together[b]
            what = f"parts of {one.label} lie" if a == b else f"{one.label} and {other.label} lie"
            reasons.append(f"{what} on one another, so that their light would count twice")
    return list(dict.fromkeys(reasons))


def _sealed(surface: _Surface, source: Array) -> Array:
    """Which triangles (n,) of a closed surface face away from a point (3,): a cupboard's foot, say."""
    a, b, c = (surface.triangles[:, i] - source for i in range(3))
    volumes = (np.cross(a, b) * c).sum(axis=1)
    # Six times the signed volume: negative ones are inside out. Those of single faces say on which side the point is.
    faces_away = volumes * np.sign(volumes.sum()) > 0.0
    return faces_away if surface.closed else np.zeros(len(a), dtype=bool)


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
    kinds: frozenset[str] = frozenset()
    unseen_by: frozenset[str] = frozenset()
    """Kinds of rays that pass it by."""
    softened: bool = False
    """Whether Cycles lets lamps shine around its corners, which are round in the shading only."""


@dataclass(frozen=True)
class Light:
    """Something that gives light in a render.

    Attributes
    ----------
    name : str
        Of the object, or of the world.
    kind : {"POINT", "SUN", "SPOT", "AREA", "SURFACE", "VOLUME", "WORLD"}
    role : str
        "spot" or "target" of a surface that moves with it, "relay_wall", or "room".
    instance : bool
        One more of an object that an instancer repeats: collection, geometry nodes, particles.
    matrix : ndarray of shape (4, 4)
        Where it stands, metres; a lamp shines along its -z.
    power : float
        Of a lamp, watts (a sun's is W/m^2); NaN of the rest.
    corners : ndarray of shape (n, 3, 3)
        Triangles of a surface that glows, in the world, metres; empty of the rest.
    """

    name: str
    kind: str
    role: str
    instance: bool
    matrix: Array
    power: float = math.nan
    corners: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def is_spot(self) -> bool:
        """Whether it is the spot of the scene itself, and no copy."""
        return self.role == "spot" and not self.instance


@dataclass
class _Reading:
    """The scene as a render sees it.

    Attributes
    ----------
    surfaces : list of _Surface
        All that are rendered.
    places : dict of str to ndarray of shape (4, 4)
        Where the objects with a role stand.
    reasons : list of str
        What else there is that `surfel` cannot honour.
    layers : list of str
        What the view layers do to a picture that only plain Cycles does.
    sky : ndarray of shape (3,) or None
        Radiance of a world that shines alike from everywhere, if it does.
    lights : list of Light
        All that give light.
    volumes : list of str
        What is filled with a volume, a phrase each.
    kinds : dict of str to frozenset of str
        Of each object that is rendered, how its materials send light on (`nodes.kinds`).
    """

    surfaces: list[_Surface] = field(default_factory=list)
    places: dict[str, Array] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)
    layers: list[str] = field(default_factory=list)
    sky: Array | None = None
    lights: list[Light] = field(default_factory=list)
    volumes: list[str] = field(default_factory=list)
    kinds: dict[str, frozenset[str]] = field(default_factory=dict)


def lights(scene: bpy.types.Scene) -> list[Light]:
    """Return everything that gives light in a render of a scene: lamps, surfaces that glow, the world; the spot too.

    Raises
    ------
    NlosError
        A role is missing or played twice.
    """
    return _read(scene).lights


def _read(scene: bpy.types.Scene) -> _Reading:
    parts = stage.target_parts(scene)
    played = {stage.find(scene, role): role for role in ("relay_wall", "spot", "camera", "target")}
    played |= dict.fromkeys(parts, "target")

    def look(depsgraph: Any) -> _Reading:
        layers = _layer_reasons(scene)
        reading = _Reading(reasons=list(layers), layers=layers)
        layer = scene.view_layers[depsgraph.view_layer.name]
        _read_world(getattr(layer, "world_override", None) or depsgraph.scene.world, reading)
        known: dict[tuple[int, ...], _Shape] = {}
        for instance in depsgraph.object_instances:
            _read_instance(instance, played, parts[0], layer, reading, known)
        return reading

    return stage.as_rendered(scene, look)


def _read_instance(
    instance: Any,
    played: dict[bpy.types.Object, str],
    target: bpy.types.Object,
    layer: bpy.types.ViewLayer,
    reading: _Reading,
    known: dict[tuple[int, ...], _Shape],
) -> None:
    obj = instance.object
    owner = (instance.parent if instance.is_instance else obj).original
    role = played.get(owner, "room")
    matrix = stage.numbers(instance.matrix_world)
    if not instance.is_instance and obj.original in played:
        reading.places[role if role != "target" or obj.original == target else obj.name] = matrix
    if obj.type == "LIGHT":
        _read_lamp(instance, played.get(obj.original, "room"), matrix, reading)
        return
    hair = [s for s in obj.particle_systems if s.settings.type == "HAIR" and s.settings.render_type == "PATH"]
    if hair and instance.show_particles:
        reading.reasons.append(f"{obj.name!r} carries hair")
        _read_substance(instance, role, matrix, reading)
    if not instance.show_self:
        return
    if obj.type in _NOT_MESH:
        reading.reasons.append(f"{obj.name!r} is {_NOT_MESH[obj.type]}, and surfel knows only faces")
        _read_substance(instance, role, matrix, reading)
        return
    if not isinstance(obj.data, bpy.types.Mesh):
        return  # a curve or text comes a second time, as the mesh made of it
    # Objects that share a mesh may differ in their materials.
    made_of = [slot.material.as_pointer() if slot.material else 0 for slot in obj.material_slots]
    key = (obj.data.as_pointer(), *made_of)
    if key not in known:
        known[key] = _shape(obj)
    shape = known[key]
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
            smooth=shape.lean > _SMOOTH,
            faces=shape.faces,
            seen=obj.visible_camera,
            flaws=tuple(f"{label} {flaw}" for flaw in flaws),
            kinds=shape.kinds,
            unseen_by=frozenset(_unseen_by(instance)),
            softened=shape.lean > _COARSE and softening(obj.original) > 0.0,
        )
    )
    reading.kinds[obj.name] = reading.kinds.get(obj.name, frozenset()) | shape.kinds
    if nodes.VOLUME in shape.kinds:
        reading.volumes.append(f"{obj.name!r} is filled with a volume")
    if shape.glowing.any() or shape.fire:
        kind = "SURFACE" if shape.glowing.any() else "VOLUME"
        shining = triangles[shape.glowing] if shape.glowing.any() else triangles
        reading.lights.append(Light(obj.name, kind, role, instance.is_instance, matrix, corners=shining))


def _read_lamp(instance: Any, role: str, matrix: Array, reading: _Reading) -> None:
    """Take down a lamp, if it shines."""
    obj, lamp = instance.object, instance.object.data
    portal = lamp.type == "AREA" and lamp.cycles.is_portal
    power = stage.lamp_power(lamp)
    if portal or power == 0.0 or not nodes.shines(lamp):
        return
    factor = nodes.radiance(lamp)
    power *= 1.0 if factor is None else sum(factor) / 3.0
    reading.lights.append(Light(obj.name, lamp.type, role, instance.is_instance, matrix, power))
    if role == "spot" and instance.is_instance:
        reading.reasons.append(f"the lamp {obj.name!r} shines once more, as an instance")
    elif role != "spot":
        reading.reasons.append(f"the lamp {obj.name!r} shines too")


def _read_world(world: Any, reading: _Reading) -> None:
    """Take down the world."""
    reading.sky, more = _sky(world)
    reading.reasons += more
    if world is None:
        return
    if nodes.glows(world):
        reading.lights.append(Light(world.name, "WORLD", "room", False, np.eye(4)))
    if nodes.read(world).volume:
        reading.volumes.append(f"the world {world.name!r} is filled with a volume")


def _read_substance(instance: Any, role: str, matrix: Array, reading: _Reading) -> None:
    """Take down hair, points and volumes, whose shape only Cycles knows."""
    obj = instance.object
    materials = [slot.material for slot in obj.material_slots] or [None]
    kinds = frozenset().union(*map(nodes.kinds, materials))
    if obj.type == "VOLUME" or nodes.VOLUME in kinds:
        kinds = frozenset({nodes.VOLUME})
        reading.volumes.append(f"{obj.name!r} is filled with a volume")
    reading.kinds[obj.name] = reading.kinds.get(obj.name, frozenset()) | kinds
    if any(map(nodes.glows, materials)):
        kind = "VOLUME" if obj.type == "VOLUME" else "SURFACE"
        reading.lights.append(Light(obj.name, kind, role, instance.is_instance, matrix))


@dataclass(frozen=True)
class _Shape:
    """The mesh of an object in its own frame; many instances may share it."""

    corners: Array
    albedo: Array
    closed: bool
    lean: float
    faces: int
    flaws: tuple[str, ...]
    kinds: frozenset[str]
    glowing: Any
    """Which of the triangles give light, (n,), bool."""
    fire: bool
    """Whether a volume inside gives light."""


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
        kinds, glowing, fire = _makings(obj, slot[solid])
        return _Shape(
            corners=corners[solid],
            albedo=colours,
            closed=bool((edges[edges > 0] == 2).all()),
            lean=_lean(mesh),
            faces=len(mesh.polygons),
            flaws=flaws,
            kinds=kinds,
            glowing=glowing,
            fire=fire,
        )
    finally:
        obj.to_mesh_clear()


def _values(collection: Any, name: str, width: int, kind: type) -> Any:
    values: Any = np.empty(len(collection) * width, dtype=kind)
    collection.foreach_get(name, values)
    return values.reshape(-1, width)


def is_smooth(mesh: Any) -> bool:
    """Whether any corner's normal leans from its face's: shading that is set smooth may well be flat all the same."""
    return _lean(mesh) > _SMOOTH


def _lean(mesh: Any) -> float:
    """By how much corners' normals lean from those of their faces, radians, at most; of a right angle no more."""
    if not len(mesh.polygons):
        return 0.0
    shading = _values(mesh.corner_normals, "vector", 3, np.float32)
    loops = _values(mesh.polygons, "loop_total", 1, np.int32)[:, 0]
    faces = np.repeat(_values(mesh.polygons, "normal", 3, np.float32), loops, axis=0)
    area = np.repeat(_values(mesh.polygons, "area", 1, np.float32)[:, 0], loops)
    sine = np.linalg.norm(np.cross(shading, faces), axis=1)
    lean = np.where((shading * faces).sum(axis=1) < 0, math.pi / 2.0, np.arcsin(np.minimum(sine, 1.0)))
    return float(lean[area > 0].max(initial=0.0))


def _slots(obj: Any, slots: Any) -> tuple[list[Any], Any]:
    """Return an object's materials, and which of them each face has, as Cycles takes it."""
    materials = [slot.material for slot in obj.material_slots] or [None]
    return materials, np.clip(slots, 0, len(materials) - 1)


def _makings(obj: Any, slots: Any) -> tuple[frozenset[str], Any, bool]:
    """Return the kinds of reflection of faces with those material slots, which of them glow, and if a volume does."""
    materials, slots = _slots(obj, slots)
    used = np.unique(slots)
    kinds: frozenset[str] = frozenset().union(*(nodes.kinds(materials[i]) for i in used))
    glowing = [i for i in used if materials[i] is not None and nodes.shines(materials[i])]
    fire = any(nodes.glows(materials[i]) and i not in glowing for i in used if materials[i] is not None)
    return kinds, np.isin(slots, glowing), fire


def _colours(obj: Any, slots: Any) -> tuple[Array, tuple[str, ...]]:
    """Return the albedo (n, 3) of faces with those material slots, and what is amiss with their materials."""
    materials, slots = _slots(obj, slots)
    table = np.zeros((len(materials), 3))
    flaws = []
    for index in np.unique(slots):
        material = materials[index]
        colour = None if material is None else nodes.diffuse(material)
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
    shader = nodes.read(material)
    if shader.volume:
        return "has a material that fills it with a volume"
    if shader.displaced:
        return "has a material that displaces it"
    if nodes.glows(material):
        return "has a material that may give light of its own"
    return "has a material that is not one constant diffuse colour"


_RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow")


def _unseen_by(instance: Any) -> list[str]:
    """Kinds of rays that pass a surface by."""
    objects = [instance.object] + ([instance.parent] if instance.is_instance else [])
    return [word for word in _RAYS if not all(getattr(o, f"visible_{word}") for o in objects)]


def _visibility_flaws(instance: Any, role: str, layer: bpy.types.ViewLayer) -> list[str]:
    objects = [instance.object] + ([instance.parent] if instance.is_instance else [])
    seeing = _RAYS if role == "relay_wall" else ("diffuse", "shadow")
    flaws = [f"is not visible to {word} rays" for word in _unseen_by(instance) if word in seeing]
    originals = [o.original for o in objects]
    if any(o.is_holdout or o.holdout_get(view_layer=layer) for o in originals):
        flaws.append("is a holdout")
    if any(o.indirect_only_get(view_layer=layer) for o in originals):
        flaws.append("is in a collection that is seen indirectly only")
    if any(o.is_shadow_catcher for o in originals):
        flaws.append("is a shadow catcher")
    if any(_terminator(o) for o in originals):
        flaws.append("has a shadow terminator offset, which darkens it where light grazes")
    return flaws


def _terminator(obj: bpy.types.Object) -> bool:
    """Whether an object's shading is made smoother where light grazes it; that acts on flat faces too."""
    if hasattr(obj, "shadow_terminator_shading_offset"):  # Blender 5; what Cycles' own panel had is left unused there
        return bool(obj.shadow_terminator_shading_offset)
    return bool(obj.cycles.shadow_terminator_offset)


def softening(obj: bpy.types.Object) -> float:
    """Return by how much Cycles moves the start of shadow rays where shading is smooth (geometry offset)."""
    return float(getattr(*softener(obj)))


def softener(obj: bpy.types.Object) -> tuple[Any, str]:
    """Return who holds `softening`, and in which attribute."""
    name = "shadow_terminator_geometry_offset"
    return (obj, name) if hasattr(obj, name) else (obj.cycles, name)


def _layer_reasons(scene: bpy.types.Scene) -> list[str]:
    """What the view layers do to a picture that only plain Cycles does."""
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
        if not layer.use_sky and stage.ambient(scene) > 0.0:
            reasons.append(f"the view layer {layer.name!r} leaves out the world's light")
    return reasons


def _sky(world: Any) -> tuple[Array | None, list[str]]:
    """Radiance (3,), W/m^2/sr, of a world that shines alike from everywhere, if it shines; what else is amiss."""
    if world is None:
        return None, []
    reasons = []
    if nodes.read(world).volume:
        reasons.append(f"the world {world.name!r} is filled with a volume")
    if not nodes.shines(world):
        return None, reasons
    if not world.cycles_visibility.diffuse:
        reasons.append(f"the world {world.name!r} is not visible to diffuse rays")
    if world.cycles.max_bounces < MAX_ORDER - 1:
        reasons.append(f"the world {world.name!r} has a limit of bounces of its own ({world.cycles.max_bounces})")
    radiance = nodes.radiance(world)
    if radiance is None:
        return None, [*reasons, f"the world {world.name!r} gives ambient light that is not one constant radiance"]
    return _lit(radiance), reasons


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
        if role in moved.places and not _alike(reading.places[role], moved.places[role], 1e-6):
            never.append(f"the {role} {stage.find(scene, role).name!r} moves when the target does")
    return reading, [*never, *_changed_lights(reading.lights, moved.lights), *_painted_by(scene, target)]


def _painted_by(scene: bpy.types.Scene, target: bpy.types.Object) -> list[str]:
    """Return what has a texture that moves with the target, and is not carried by it."""
    carried = {target, *target.children_recursive}
    painted: list[tuple[str, Any]] = [(f"the world {scene.world.name!r}", scene.world)] if scene.world else []
    for obj in scene.objects:
        if obj not in carried:
            blocks = [obj.data] if obj.type == "LIGHT" else [slot.material for slot in obj.material_slots]
            painted += [(f"{obj.name!r}", block) for block in blocks if block is not None]
    return [
        f"{label} has a texture in the coordinates of {anchor.name!r}, which moves with the target"
        for label, block in painted
        for anchor in nodes.anchors(block) & carried
    ]


def _changed_lights(before: Sequence[Light], after: Sequence[Light]) -> list[str]:
    """Return what lights, those that the target carries left out, do when it moves."""
    one, other = ([light for light in some if light.role != "target"] for some in (before, after))
    if len(one) != len(other):
        return ["there are other lights when the target moves"]
    labels = []
    for light, now in zip(one, other, strict=True):
        if not np.array_equal(light.power, now.power, equal_nan=True):
            labels.append(f"the light {light.name!r} changes its power when the target moves")
        elif light.role != "spot" and not _alike(light.matrix, now.matrix, 1e-6):
            labels.append(f"the light {light.name!r} moves when the target does")
    return labels


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
    # Where a render has it: of what the viewport hides Blender does not keep the place up to date.
    matrix = reading.places.get("spot", stage.numbers(lamp.matrix_world))
    reasons = _lamp_reasons(lamp, matrix, stage.reflection_order(scene))
    if "spot" not in reading.places:
        reasons.append(f"the spot {lamp.name!r} is hidden from renders")
    reasons += _reflection_reasons(scene, reading)
    surfaces = [s for s in reading.surfaces if s.role != "target"]
    walls = [s for s in surfaces if s.role == "relay_wall"]
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
        * np.array(nodes.radiance(light) or (0.0, 0.0, 0.0))
        * (light.energy * 2.0 ** getattr(light, "exposure", 0.0) / (4.0 * math.pi)),
        albedo=np.zeros(3),
        cos_outer=math.cos(half),
        cos_width=(1.0 - math.cos(half)) * blend,
    )
    turns = np.arange(64)[:, None] * (2.0 * math.pi / 64)
    rim = patch.centre + _RIM * (np.cos(turns) * patch.major + np.sin(turns) * patch.minor)
    apex = np.append(origin, 1.0)
    sides = _pyramid(rim, apex)
    before = [*sides, _Plane(normal, float(normal @ point) + 1e-4 * height)]
    colour = _colour_within(walls, [*sides, *_near(normal, point, 1e-4 * height)])
    if colour is None:
        reasons.append(f"the relay wall {wall.name!r} has more than one colour where {lamp.name!r} lights it")
    else:
        patch = replace(patch, albedo=colour)
    blocking = [s for s in surfaces if _areas(s.triangles, before).sum() > _NOTHING * major * minor]
    reasons += [_blocked(lamp, wall, s) for s in blocking]
    if not blocking and not _covered(surfaces, sides, point, normal, rim, 1e-4 * height):
        reasons.append(_blocked(lamp, wall, None))
    return (None if reasons else patch), list(dict.fromkeys(reasons))


def _lamp_reasons(lamp: bpy.types.Object, matrix: Array, order: int) -> list[str]:
    """What is special about a spot lamp."""
    light, name = lamp.data, f"the spot {lamp.name!r}"
    reasons = []
    if light.shadow_soft_size > 0:
        reasons.append(f"{name} has a radius of {light.shadow_soft_size:g} m, not 0")
    factor = nodes.radiance(light)
    if factor is None or min(factor) < 0.0 or nodes.read(light).volume:
        reasons.append(f"{name} has shader nodes of its own that are not one constant emission")
    if getattr(light, "use_temperature", False):
        reasons.append(f"{name} takes its colour from a temperature")
    if not getattr(light, "normalize", True):
        reasons.append(f"{name} has a power that is not normalised")
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    if np.ptp(scale) > 1e-5 * scale.max():
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


def _reflection_reasons(scene: bpy.types.Scene, reading: _Reading) -> list[str]:
    """Why the first reflection, in closed form and sent out by a lamp, would not be what Cycles finds."""
    reasons = [*reading.layers, *reading.volumes]
    copies = [light for light in reading.lights if light.role == "spot" and light.instance]
    reasons += [f"the lamp {light.name!r} shines once more, as an instance" for light in copies]
    for wall in (s for s in reading.surfaces if s.role == "relay_wall"):
        reasons += wall.flaws
        if wall.smooth:
            reasons.append(f"{wall.label} is shaded smooth, so that it reflects as if it were curved")
    reasons += _passed_by(reading)
    reasons += _bounce_reasons(scene, reading)
    reasons += _transparent_reasons(scene, reading)
    if others := other_lights(reading.lights):
        reasons += [
            f"{s.label} is shaded smooth over coarse faces, around which lamps shine (shadow terminator geometry "
            f"offset), while {others[0].name!r} shines too"
            for s in reading.surfaces
            if s.softened
        ]
    return list(dict.fromkeys(reasons))


def _passed_by(reading: _Reading) -> list[str]:
    """What some rays meet and others pass by.

    The way from the object to the lit patch is that of a reflected ray in Cycles, and that of a shadow ray where a
    lamp stands for the patch.
    """
    kinds = frozenset().union(*reading.kinds.values())
    reflected = {"diffuse", *({nodes.GLOSSY, nodes.TRANSMISSION} & kinds)}
    reasons = []
    for surface in reading.surfaces:
        unseen = surface.unseen_by & {"shadow", *reflected}
        if unseen and unseen != {"shadow", *reflected}:
            words = " and ".join(word for word in _RAYS if word in unseen)
            reasons.append(f"{surface.label} is not visible to {words} rays, and is to others")
    return reasons


def _bounce_reasons(scene: bpy.types.Scene, reading: _Reading) -> list[str]:
    """Which materials need a limit of bounces that one number cannot say, or a lamp that rays meet by chance."""
    cycles = scene.cycles
    others = other_lights(reading.lights)
    reasons = []
    for name, kinds in reading.kinds.items():
        ways = [kind for kind in (nodes.GLOSSY, nodes.TRANSMISSION) if kind in kinds]
        if nodes.UNKNOWN in kinds:
            reasons.append(f"{name!r} has a material that sends light where only Cycles knows")
        if not ways:
            continue
        limits = {kind: getattr(cycles, f"{kind}_bounces") for kind in ("diffuse", *ways)}
        low = min(limits, key=lambda kind: limits[kind])
        if limits[low] < cycles.max_bounces:
            reasons.append(
                f"{name!r} has a {ways[0]} material, and the limit of {low} bounces ({limits[low]}) is below that of "
                f"all ({cycles.max_bounces})"
            )
        if nodes.MIRROR in kinds and others:
            reasons.append(f"{name!r} may reflect like a mirror while {others[0].name!r} shines too")
    return reasons


def _transparent_reasons(scene: bpy.types.Scene, reading: _Reading) -> list[str]:
    """Why the limit of transparent bounces may tell: to a shadow ray it is one more than to a path."""
    limit, legs = scene.cycles.transparent_max_bounces, stage.reflection_order(scene)
    clear = [s for s in reading.surfaces if nodes.TRANSPARENT in s.kinds]
    known = {s.name for s in clear}
    unknown = [name for name, kinds in reading.kinds.items() if nodes.TRANSPARENT in kinds and name not in known]
    crossed = legs * sum(_planes(s.triangles) for s in clear)
    if not unknown and crossed < limit:
        return []
    names = [*unknown, *(s.name for s in clear)]
    return [
        f"{names[0]!r} is transparent, and light may cross more such faces than the limit of transparent bounces "
        f"({limit}) surely allows"
        for _ in names[:1]
    ]


def _planes(triangles: Array) -> int:
    """Return in how many planes triangles (n, 3, 3) lie: a straight line crosses no more of them."""
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    main = normals[np.arange(len(normals)), np.abs(normals).argmax(axis=1)]
    normals = normals * np.sign(main)[:, None]  # both sides of a plane are one
    size = np.ptp(triangles.reshape(-1, 3), axis=0).max()
    offsets = (normals * (triangles[:, 0] - triangles[0, 0])).sum(axis=1) / size
    return len(np.unique(np.round(np.column_stack([normals, offsets]), 4), axis=0))


def other_lights(found: Sequence[Light]) -> list[Light]:
    """Return those of the lights that are not the spot itself."""
    return [light for light in found if not light.is_spot]


def _near(normal: Array, point: Array, slack: float) -> list[_Plane]:
    """The slab around a plane."""
    at = float(normal @ point)
    return [_Plane(normal, at - slack), _Plane(-normal, -at - slack)]


def _colour_within(walls: Sequence[_Surface], planes: Sequence[_Plane]) -> Array | None:
    """Return the albedo (3,) of walls inside all of the planes; None if it is not everywhere the same."""
    if not walls:
        return np.zeros(3)
    areas = np.concatenate([_areas(s.triangles, planes) for s in walls])
    albedo = np.concatenate([s.albedo for s in walls])[areas > _NOTHING * areas.sum()]
    if not len(albedo):
        return np.zeros(3)
    return None if np.ptp(albedo, axis=0).any() else albedo[0]


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
    matrix = reading.places.get("camera", stage.numbers(camera.matrix_world))
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
        albedo=np.zeros(3),
        resolution=resolution,
    )
    reach = (watched.points(_CORNERS) - eye) @ forward
    if reach.min() < lens.clip_start or reach.max() > lens.clip_end:
        reasons.append(f"{name} clips the relay wall {wall.name!r}")
    outline = watched.points(_EDGE + (1.0 - 2.0 * _EDGE) * _CORNERS)
    sides = _pyramid(outline, seen_from)
    slack = 1e-4 * float(reach.min())
    colour = _colour_within([s for s in surfaces if s.role == "relay_wall"], [*sides, *_near(normal, point, slack)])
    if colour is None:
        reasons.append(f"the relay wall {wall.name!r} has more than one colour where {name} sees it")
    else:
        watched = replace(watched, albedo=colour)
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
