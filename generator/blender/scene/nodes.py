"""Reads the shader nodes of materials, lamps and worlds as far as Cycles evaluates them; all other modules use it.

A tree may hold much that has no effect: nodes that lead to no output, outputs for EEVEE, muted nodes and links, links
that Blender marks as invalid. The rest is returned as the shader nodes whose light reaches the output, with those of
their inputs that are constant. Whatever cannot be determined is reported as unknown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import bpy

Value = float | tuple[float, ...]

DIFFUSE, GLOSSY, TRANSMISSION, TRANSPARENT = "diffuse", "glossy", "transmission", "transparent"
MIRROR, SUBSURFACE, VOLUME, UNKNOWN = "mirror", "subsurface", "volume", "unknown"

_SINGULAR = 0.01
"""Roughness below which Cycles may treat a reflector as a perfect mirror, for which it cannot sample lamps."""
_LUMINANCE = (0.2126390, 0.7151687, 0.0721923)
"""Luminance weights of linear Rec. 709, by which a colour is converted to a number."""
_DEEP = 64
"""Largest nesting depth of node groups; deeper groups are not followed."""
_DARK = {
    *("BSDF_DIFFUSE", "BSDF_GLOSSY", "BSDF_GLASS", "BSDF_REFRACTION", "BSDF_TRANSLUCENT", "BSDF_TRANSPARENT"),
    *("BSDF_METALLIC", "BSDF_SHEEN", "BSDF_TOON", "BSDF_HAIR", "BSDF_HAIR_PRINCIPLED", "BSDF_RAY_PORTAL"),
    *("SUBSURFACE_SCATTERING", "HOLDOUT", "VOLUME_ABSORPTION", "VOLUME_SCATTER"),
}
"""Shaders that never emit light."""


@dataclass(frozen=True)
class Part:
    """A shader node whose light reaches the output.

    Attributes
    ----------
    kind : str
        Blender's type of the node.
    inputs : mapping of str to float or tuple of float or None
        Values by socket name; None where the value varies in space or cannot be determined.
    linked : frozenset of str
        Names of the inputs whose value comes from a link rather than from the node.
    component : str
        Selected component, or distribution, of a node that has several, else empty.
    images : mapping of str to bpy.types.Image
        Images that are linked directly into the node, by socket name.
    weight : float or None
        Factor on its light, from sums and mixtures; None where it varies in space or cannot be determined.
    """

    kind: str
    inputs: Mapping[str, Value | None]
    linked: frozenset[str] = frozenset()
    component: str = ""
    images: Mapping[str, Any] = field(default_factory=dict)
    weight: float | None = 1.0

    def is_zero(self, name: str) -> bool:
        """Whether an input is certainly 0, or black, or missing."""
        value = self.inputs.get(name, 0.0)
        return value is not None and not any(value[:3] if isinstance(value, tuple) else (value,))

    def colour(self, name: str) -> tuple[float, float, float] | None:
        """Return an input as a colour if it is constant, else None."""
        value = self.inputs.get(name)
        if not isinstance(value, tuple):
            return None if value is None else (value, value, value)
        return (float(value[0]), float(value[1]), float(value[2]))


@dataclass(frozen=True)
class Shader:
    """The shaders of a material, lamp or world, as Cycles sees them."""

    surface: tuple[Part, ...] = ()
    volume: tuple[Part, ...] = ()
    displaced: bool = False


def read(block: Any) -> Shader:
    """Return the shaders of a material, lamp or world that Cycles would evaluate.

    Parameters
    ----------
    block : bpy.types.Material, bpy.types.World, bpy.types.Light or None
        None stands for an object without a material, for which Cycles uses its default material.

    Returns
    -------
    Shader
        Has no parts if it neither reflects nor emits light.
    """
    if block is None:
        inputs: dict[str, Value | None] = {"Base Color": (0.8, 0.8, 0.8), "Roughness": 0.5, "Specular IOR Level": 0.5}
        return Shader(surface=(Part("BSDF_PRINCIPLED", {**inputs, "Alpha": 1.0}),))
    if not uses_nodes(block):
        return Shader(surface=(_flat(block),))
    output = block.node_tree.get_output_node("CYCLES")
    if output is None or (output.mute and bpy.app.version < (5, 0)):
        return Shader()
    reader = _Reader()
    sockets = {name: output.inputs[name] for name in ("Surface", "Volume", "Displacement") if name in output.inputs}
    surface, volume = (
        tuple(reader.parts(sockets[name], ())) if name in sockets else () for name in ("Surface", "Volume")
    )
    displaced = "Displacement" in sockets and reader.origin(sockets["Displacement"], ()) is not None
    return Shader(surface=surface, volume=tuple(p for p in volume if not _thin(p)), displaced=displaced)


def uses_nodes(block: Any) -> bool:
    """Whether a material, lamp or world is defined by its nodes.

    Blender 5 always uses the nodes of materials and worlds, and 5.2 those of lamps; `use_nodes` is deprecated there.
    """
    if block.node_tree is None:
        return False
    since = (5, 2) if isinstance(block, bpy.types.Light) else (5, 0)
    return bpy.app.version >= since or bool(block.use_nodes)


@dataclass(frozen=True)
class Glossy:
    """Glossy reflection of one roughness, by microfacets of the distribution GGX.

    Attributes
    ----------
    colour : (float, float, float)
        Reflectivity of the facets, per colour channel.
    share : float
        Factor on its light.
    roughness : float
    multiple : bool
        Whether light leaves after more than one facet, too ("Multiscatter GGX").
    """

    colour: tuple[float, float, float]
    share: float
    roughness: float
    multiple: bool


@dataclass(frozen=True)
class Reflector:
    """A surface that reflects and sends light alike at every point, and in directions that are known.

    Attributes
    ----------
    albedo : (float, float, float)
        Of its Lambertian reflection, per colour channel.
    radiance : (float, float, float)
        Of its own light, per colour channel, W/m^2/sr.
    glossy : Glossy or None
        What it reflects besides.
    """

    albedo: tuple[float, float, float]
    radiance: tuple[float, float, float]
    glossy: Glossy | None = None


def reflector(material: Any) -> Reflector | None:
    """Return what a material reflects and emits, if that is constant and known and all there is, else None."""
    shader = read(material)
    if shader.displaced or shader.volume:
        return None
    albedo, radiance = [0.0] * 3, [0.0] * 3
    glossy: Glossy | None = None
    for part in shader.surface:
        if part.kind == "EMISSION" and not _shines(part):
            continue
        if part.weight is None or "Normal" in part.linked:
            return None
        reflected: tuple[float, ...] | None = (0.0, 0.0, 0.0)
        if part.kind == "BSDF_DIFFUSE" and part.is_zero("Roughness"):
            reflected = part.colour("Color")
        elif part.kind == "BSDF_PRINCIPLED" and _only_diffuse(part):
            reflected = part.colour("Base Color")
        elif part.kind == "BSDF_GLOSSY":
            found = _glossy(part)
            if found is None or glossy is not None:
                return None
            glossy = found
        elif part.kind != "EMISSION":
            return None
        sent = _radiance(part) if _shines(part) else (0.0, 0.0, 0.0)
        if reflected is None or sent is None:
            return None
        albedo = [a + part.weight * c for a, c in zip(albedo, reflected, strict=True)]
        radiance = [r + part.weight * c for r, c in zip(radiance, sent, strict=True)]
    return Reflector((albedo[0], albedo[1], albedo[2]), (radiance[0], radiance[1], radiance[2]), glossy)


def diffuse(material: Any) -> tuple[float, float, float] | None:
    """Return the RGB albedo of a material that is a constant Lambertian reflector and nothing else, else None."""
    found = reflector(material)
    return None if found is None or any(found.radiance) or found.glossy is not None else found.albedo


def _glossy(part: Part) -> Glossy | None:
    """Return a glossy shader's reflection if it is constant, alike around the normal, and of a known distribution."""
    colour, roughness, share = part.colour("Color"), part.inputs.get("Roughness"), part.weight
    if colour is None or not isinstance(roughness, float) or share is None:
        return None
    if not part.is_zero("Anisotropy") or part.component not in ("GGX", "MULTI_GGX"):
        return None
    return Glossy(colour, share, min(1.0, max(0.0, roughness)), part.component == "MULTI_GGX")


def glows(block: Any) -> bool:
    """Whether a material, lamp or world may emit light; False is certain."""
    shader = read(block)
    return any(map(_shines, (*shader.surface, *shader.volume)))


def shines(block: Any) -> bool:
    """Whether the surface of a world or lamp may emit light; its volume is ignored."""
    return any(map(_shines, read(block).surface))


def radiance(block: Any) -> tuple[float, float, float] | None:
    """Return a world's uniform radiance, W/m^2/sr, or the factor that a lamp's nodes apply to its light, else None.

    Returns
    -------
    (float, float, float) or None
        Per colour channel; None if it varies with direction or position, or cannot be determined.
    """
    total = [0.0, 0.0, 0.0]
    for part in read(block).surface:
        if part.kind not in ("BACKGROUND", "EMISSION"):
            return None
        if not _shines(part):
            continue
        sent = _radiance(part)
        if sent is None or part.weight is None:
            return None
        total = [t + part.weight * c for t, c in zip(total, sent, strict=True)]
    return (total[0], total[1], total[2])


def level(block: Any) -> float:
    """Return a world's mean radiance, W/m^2/sr, or its strength if it has a texture; 0 if it emits no light."""
    total = 0.0
    for part in filter(_shines, read(block).surface):
        strength, colour = part.inputs.get("Strength"), part.colour("Color")
        power = (strength if isinstance(strength, float) else 1.0) * (1.0 if part.weight is None else part.weight)
        total += abs(power * (sum(colour) / 3.0 if colour is not None else 1.0))
    return total


def darkened(world: bpy.types.World) -> bpy.types.World:
    """Return a copy of a world whose surface emits no light; its volume is kept."""
    dark = world.copy()
    if not uses_nodes(dark):
        dark.color = (0.0, 0.0, 0.0)
        return dark
    tree = dark.node_tree
    for link in [k for k in tree.links if k.to_node.type == "OUTPUT_WORLD" and k.to_socket.name == "Surface"]:
        tree.links.remove(link)
    return dark


def kinds(material: Any) -> frozenset[str]:
    """Return the kinds of scattering of a material: "diffuse", "glossy" and so on, as Cycles counts bounces.

    Parameters
    ----------
    material : bpy.types.Material or None

    Returns
    -------
    frozenset of str
        Contains "mirror" in addition if glossy reflection or transmission may have one direction only.
    """
    shader = read(material)
    scattering = {kind for part in shader.surface for kind in _kinds(part)}
    return frozenset(scattering | ({VOLUME} if shader.volume else set()))


def anchors(block: Any) -> set[bpy.types.Object]:
    """Return the objects in whose coordinates a material, lamp or world may evaluate its textures."""
    if not uses_nodes(block):
        return set()
    objects: set[bpy.types.Object] = set()
    trees, seen = [block.node_tree], set()
    while trees:
        tree = trees.pop()
        if tree is None or tree in seen:
            continue
        seen.add(tree)
        for node in tree.nodes:
            if node.type == "GROUP":
                trees.append(node.node_tree)
            elif node.type == "TEX_COORD" and node.object is not None and node.outputs["Object"].is_linked:
                objects.add(node.object)
    return objects


def _flat(block: Any) -> Part:
    """Shader equivalent of a data-block that does not use nodes."""
    if isinstance(block, bpy.types.World):
        return Part("BACKGROUND", {"Color": tuple(block.color), "Strength": 1.0})
    if isinstance(block, bpy.types.Light):
        return Part("EMISSION", {"Color": (1.0, 1.0, 1.0), "Strength": 1.0})
    return Part("BSDF_DIFFUSE", {"Color": tuple(block.diffuse_color)[:3], "Roughness": 0.0})


def _shines(part: Part) -> bool:
    """Whether a shader may emit light; False is certain."""
    if part.kind in ("EMISSION", "BACKGROUND"):
        return not (part.is_zero("Color") or part.is_zero("Strength"))
    if part.kind == "BSDF_PRINCIPLED":
        return not (part.is_zero("Emission Color") or part.is_zero("Emission Strength"))
    if part.kind == "PRINCIPLED_VOLUME":
        emits = not (part.is_zero("Emission Color") or part.is_zero("Emission Strength"))
        return emits or not part.is_zero("Blackbody Intensity")
    if part.kind == "VOLUME_COEFFICIENTS":
        return not part.is_zero("Emission Coefficients")
    return part.kind not in _DARK


def _radiance(part: Part) -> tuple[float, float, float] | None:
    """Return the radiance of a shader that shines, before its weight, if it is constant."""
    prefix = "Emission " if part.kind == "BSDF_PRINCIPLED" else ""
    colour, strength = part.colour(f"{prefix}Color"), part.inputs.get(f"{prefix}Strength")
    if colour is None or not isinstance(strength, float):
        return None
    return (strength * colour[0], strength * colour[1], strength * colour[2])


def _thin(part: Part) -> bool:
    """Whether a volume shader certainly has no effect."""
    return part.kind in ("VOLUME_ABSORPTION", "VOLUME_SCATTER") and part.is_zero("Density")


def _only_diffuse(part: Part) -> bool:
    weights = ("Metallic", "Specular IOR Level", "Transmission Weight", "Subsurface Weight", "Coat Weight")
    zero = (*weights, "Sheen Weight", "Diffuse Roughness", "Thin Film Thickness")
    return part.inputs.get("Alpha") == 1.0 and all(map(part.is_zero, zero))


def _kinds(part: Part) -> set[str]:
    simple = {
        "BSDF_DIFFUSE": {DIFFUSE},
        "BSDF_SHEEN": {DIFFUSE},
        "BSDF_TRANSLUCENT": {TRANSMISSION},
        "BSDF_TRANSPARENT": {TRANSPARENT},
        "BSDF_HAIR_PRINCIPLED": {GLOSSY, TRANSMISSION},
        "SUBSURFACE_SCATTERING": {DIFFUSE, SUBSURFACE},
        "EMISSION": set(),
        "HOLDOUT": set(),
    }
    if part.kind in simple:
        return simple[part.kind]
    if part.kind == "BSDF_TOON":
        return {DIFFUSE if part.component == "DIFFUSE" else GLOSSY}
    if part.kind == "BSDF_HAIR":
        return {GLOSSY if part.component == "Reflection" else TRANSMISSION}
    if part.kind == "BSDF_PRINCIPLED":
        return _principled(part)
    by_roughness = {
        "BSDF_GLOSSY": {GLOSSY},
        "BSDF_METALLIC": {GLOSSY},
        "BSDF_GLASS": {GLOSSY, TRANSMISSION},
        "BSDF_REFRACTION": {TRANSMISSION},
    }
    if part.kind not in by_roughness:
        return {UNKNOWN}
    return by_roughness[part.kind] | ({MIRROR} if _singular(part, "Roughness") else set())


def _principled(part: Part) -> set[str]:
    scattering = {DIFFUSE}
    if not all(map(part.is_zero, ("Metallic", "Specular IOR Level", "Transmission Weight"))):
        scattering |= {GLOSSY} | ({MIRROR} if _singular(part, "Roughness") else set())
    if not part.is_zero("Coat Weight"):
        scattering |= {GLOSSY} | ({MIRROR} if _singular(part, "Coat Roughness") else set())
    if not part.is_zero("Transmission Weight"):
        scattering.add(TRANSMISSION)
    if not part.is_zero("Subsurface Weight"):
        scattering.add(SUBSURFACE)
    if part.inputs.get("Alpha") != 1.0:
        scattering.add(TRANSPARENT)
    return scattering


def _singular(part: Part, name: str) -> bool:
    roughness = part.inputs.get(name)
    return not isinstance(roughness, float) or roughness < _SINGULAR


# --------------------------------------------------------------------------------------------------------------------
# Following the links
# --------------------------------------------------------------------------------------------------------------------

Path = tuple[Any, ...]
"""The group nodes that enclose a tree, outermost first."""


@dataclass(frozen=True)
class _Origin:
    """Start of a link: an output of a node, or a constant value."""

    node: Any = None
    output: Any = None
    path: Path = ()
    value: Value | None = None
    shader: bool = False


@dataclass(frozen=True)
class _Term:
    """A shader, or a sum or mixture of others: their sockets, the groups around these, and their shares."""

    key: Path
    shader: Part | None = None
    inputs: tuple[tuple[Any, Path, float | None], ...] = ()


_NOWHERE = _Origin()
"""A link without a usable start: into a group that has no tree or is nested too deep."""


@dataclass
class _Reader:
    """Follows links through reroutes, muted nodes and groups."""

    links: dict[int, dict[int, Any]] = field(default_factory=dict)

    def parts(self, socket: Any, path: Path) -> Iterator[Part]:
        """Yield the shaders whose sum or mixture reaches a socket, each once, with its weight."""
        root = self._term(socket, path)
        shaders: dict[Path, Part | None] = {}
        links: dict[Path, list[tuple[Path, float | None]]] = {}
        todo = [] if root is None else [root]
        while todo:
            term = todo.pop()
            if term.key in shaders:
                continue
            found = [(self._term(*place), share) for *place, share in term.inputs]
            shaders[term.key] = term.shader
            links[term.key] = [(inner.key, share) for inner, share in found if inner is not None]
            todo += [inner for inner, _ in found if inner is not None]
        missing = Counter(key for inner in links.values() for key, _ in inner)
        weights: dict[Path, float | None] = dict.fromkeys(shaders, 0.0)
        ready = [] if root is None else [root.key]
        weights |= dict.fromkeys(ready, 1.0)
        while ready:  # a term comes after all those that it is an input of
            key = ready.pop()
            weight, shader = weights[key], shaders[key]
            if shader is not None:
                yield replace(shader, weight=weight)
            for inner, share in links[key]:
                before = weights[inner]
                known = before is not None and weight is not None and share is not None
                weights[inner] = before + weight * share if known else None  # type: ignore[operator]
                missing[inner] -= 1
                if not missing[inner]:
                    ready.append(inner)

    def _term(self, socket: Any, path: Path) -> _Term | None:
        """Return what reaches a socket; None if it is nothing."""
        origin = self.origin(socket, path)
        if origin is None or origin is _NOWHERE:
            return None
        if not origin.shader:  # Cycles emits a colour that is linked where a shader is expected
            # (a tenth of it for a world, before Blender 5).
            colour = origin.value if bpy.app.version >= (5, 0) else None
            emission = Part("EMISSION", {"Color": colour, "Strength": 1.0}, frozenset({"Color"}))
            return _Term(_pointers(socket, path), emission)
        node, path = origin.node, origin.path
        key = _pointers(node, path)
        if node.type == "MIX_SHADER":
            share = self.value(node.inputs[0], path)
            second = min(1.0, max(0.0, share)) if isinstance(share, float) else None
            shares = (None if second is None else 1.0 - second, second)
        elif node.type == "ADD_SHADER":
            shares = (1.0, 1.0)
        elif node.type == "EEVEE_SPECULAR":  # which Cycles does not have
            return None
        else:
            return _Term(key, self._part(node, path))
        pairs = zip(node.inputs[-2:], shares, strict=True)
        return _Term(key, None, tuple((term, path, share) for term, share in pairs if share != 0.0))

    def _part(self, node: Any, path: Path) -> Part:
        inputs = [s for s in node.inputs if s.enabled and not getattr(s, "is_unavailable", False)]
        origins = {s.name: self.origin(s, path) for s in inputs}
        images = {name: getattr(o.node, "image", None) for name, o in origins.items() if o is not None}
        return Part(
            kind=node.type,
            inputs={s.name: self.value(s, path) for s in inputs},
            linked=frozenset(name for name, origin in origins.items() if origin is not None),
            component=str(getattr(node, "component", getattr(node, "distribution", ""))),
            images={name: image for name, image in images.items() if image is not None},
        )

    def value(self, socket: Any, path: Path) -> Value | None:
        """Return the value that reaches a socket if it is constant, else None."""
        origin = self.origin(socket, path)
        if origin is None:
            return _default(socket)
        if origin is _NOWHERE or origin.value is None:
            return None
        return _as(socket.type, origin.value)

    def origin(self, socket: Any, path: Path) -> _Origin | None:
        """Return the start of the link into a socket; None if the socket is effectively unlinked."""
        for _ in range(10_000):
            link = self._link(socket)
            if link is None:
                return None
            node, output = link.from_node, link.from_socket
            if node.mute or node.type == "REROUTE":
                inner = next((k.from_socket for k in node.internal_links if k.to_socket == output), None)
                if inner is None:
                    return None
                socket = inner
                if bpy.app.version < (5, 0) and self._link(socket) is None:
                    return _Origin(value=0.0)  # later versions treat it as unlinked
            elif node.type in ("GROUP", "CUSTOM GROUP"):
                inner = _group_output(node, output)
                if inner is None or len(path) > _DEEP:
                    return _NOWHERE
                socket, path = inner, (*path, node)
                if self._link(socket) is None:
                    return self._constant(socket)
            elif node.type == "GROUP_INPUT":
                outer = [s for s in path[-1].inputs if s.identifier == output.identifier] if path else []
                if not outer:
                    return _NOWHERE
                socket, path = outer[0], path[:-1]
                if self._link(socket) is None:
                    return self._constant(socket)
            elif node.type in ("RGB", "VALUE"):
                return self._constant(node.outputs[0])
            else:
                return _Origin(node, output, path, shader=output.type == "SHADER")
        return _NOWHERE

    def _constant(self, socket: Any) -> _Origin | None:
        value = _default(socket)
        return _NOWHERE if value is None else _Origin(value=value)

    def _link(self, socket: Any) -> Any:
        """The effective link into a socket, or None."""
        tree = socket.id_data
        key = tree.as_pointer()
        if key not in self.links:
            self.links[key] = {
                link.to_socket.as_pointer(): link
                for link in tree.links
                if link.is_valid and not link.is_muted and link.from_socket.enabled and link.to_socket.enabled
            }
        return self.links[key].get(socket.as_pointer())


def _pointers(item: Any, path: Path) -> Path:
    """Return what identifies a node or socket inside groups."""
    return (item.as_pointer(), *(group.as_pointer() for group in path))


def _group_output(node: Any, output: Any) -> Any:
    """The socket inside a group that feeds one of its outputs, or None."""
    tree = node.node_tree
    outputs = [n for n in tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output] if tree else []
    return next((s for end in outputs for s in end.inputs if s.identifier == output.identifier), None)


def _default(socket: Any) -> Value | None:
    value = getattr(socket, "default_value", None)
    if value is None or isinstance(value, str):
        return None
    if isinstance(value, (bool, int, float)):
        return float(value)
    return tuple(float(v) for v in value)


def _as(kind: str, value: Value) -> Value:
    """Convert a value as a socket of the given type does."""
    if kind in ("RGBA", "VECTOR"):
        width = 4 if kind == "RGBA" else 3
        channels = (value,) * 3 if isinstance(value, float) else value
        return (*channels[:3], 1.0)[:width]
    if isinstance(value, float):
        return value
    if len(value) == 4:
        return sum(w * v for w, v in zip(_LUMINANCE, value, strict=False))
    return sum(value) / 3.0
