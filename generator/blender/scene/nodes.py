"""What Cycles would evaluate of a tree of shader nodes, and nothing else: the one reader of materials, lamps, worlds.

A tree may hold much that does not count: what leads to no output, outputs of EEVEE's, muted nodes and links, links
that Blender calls invalid. What counts comes back as the shader nodes whose light reaches the output, with those of
their inputs that are the same everywhere. What cannot be known is said to be so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import bpy

Value = float | tuple[float, ...]

DIFFUSE, GLOSSY, TRANSMISSION, TRANSPARENT = "diffuse", "glossy", "transmission", "transparent"
MIRROR, SUBSURFACE, VOLUME, UNKNOWN = "mirror", "subsurface", "volume", "unknown"

_SINGULAR = 0.01
"""A roughness below which Cycles may take a reflector for a perfect mirror, which no lamp can be sampled for."""
_LUMINANCE = (0.2126390, 0.7151687, 0.0721923)
"""Of linear Rec. 709, as a colour is made one number."""
_DEEP = 64
"""Groups in groups in groups: what is deeper is not followed."""
_DARK = {
    *("BSDF_DIFFUSE", "BSDF_GLOSSY", "BSDF_GLASS", "BSDF_REFRACTION", "BSDF_TRANSLUCENT", "BSDF_TRANSPARENT"),
    *("BSDF_METALLIC", "BSDF_SHEEN", "BSDF_TOON", "BSDF_HAIR", "BSDF_HAIR_PRINCIPLED", "BSDF_RAY_PORTAL"),
    *("SUBSURFACE_SCATTERING", "HOLDOUT", "VOLUME_ABSORPTION", "VOLUME_SCATTER"),
}
"""Shaders that never give light of their own."""


@dataclass(frozen=True)
class Part:
    """A shader node whose light reaches the output.

    Attributes
    ----------
    kind : str
        Blender's type of the node.
    inputs : mapping of str to float or tuple of float or None
        By the socket's name; None where the value changes from place to place, or cannot be known.
    linked : frozenset of str
        The inputs that are not as the node itself has them.
    component : str
        Of a node that has several, else empty.
    images : mapping of str to bpy.types.Image
        By the socket's name, the images that are linked straight into the node.
    """

    kind: str
    inputs: Mapping[str, Value | None]
    linked: frozenset[str] = frozenset()
    component: str = ""
    images: Mapping[str, Any] = field(default_factory=dict)

    def is_zero(self, name: str) -> bool:
        """Whether an input is surely 0, or black, or missing."""
        value = self.inputs.get(name, 0.0)
        return value is not None and not any(value[:3] if isinstance(value, tuple) else (value,))

    def colour(self, name: str) -> tuple[float, float, float] | None:
        """Return a colour that is the same everywhere, else None."""
        value = self.inputs.get(name)
        if not isinstance(value, tuple):
            return None if value is None else (value, value, value)
        return (float(value[0]), float(value[1]), float(value[2]))


@dataclass(frozen=True)
class Shader:
    """What a material, a lamp or a world is made of, as Cycles sees it."""

    surface: tuple[Part, ...] = ()
    volume: tuple[Part, ...] = ()
    displaced: bool = False


def read(block: Any) -> Shader:
    """Return what Cycles would evaluate of a material, lamp or world.

    Parameters
    ----------
    block : bpy.types.Material, bpy.types.World, bpy.types.Light or None
        None is an object without a material, for which Cycles takes its own.

    Returns
    -------
    Shader
        Without any part if it neither reflects nor shines.
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
    ends = {name: output.inputs[name] for name in ("Surface", "Volume", "Displacement") if name in output.inputs}
    surface, volume = (tuple(reader.parts(ends[name], ())) if name in ends else () for name in ("Surface", "Volume"))
    displaced = "Displacement" in ends and reader.origin(ends["Displacement"], ()) is not None
    return Shader(surface=surface, volume=tuple(p for p in volume if not _thin(p)), displaced=displaced)


def uses_nodes(block: Any) -> bool:
    """Whether a material, lamp or world is what its nodes say.

    Blender 5 always takes the nodes of materials and worlds, and 5.2 those of lamps; to ask is deprecated there.
    """
    if block.node_tree is None:
        return False
    always = (5, 2) if isinstance(block, bpy.types.Light) else (5, 0)
    return bpy.app.version >= always or bool(block.use_nodes)


def diffuse(material: Any) -> tuple[float, float, float] | None:
    """Return the RGB albedo of a material that is a constant Lambertian reflector and nothing else, else None."""
    shader = read(material)
    if shader.displaced or shader.volume:
        return None
    parts = [part for part in shader.surface if part.kind != "EMISSION" or _shines(part)]
    if not parts:
        return (0.0, 0.0, 0.0)
    part = parts[0]
    if len(parts) > 1 or "Normal" in part.linked:
        return None
    if part.kind == "BSDF_DIFFUSE" and part.is_zero("Roughness"):
        return part.colour("Color")
    if part.kind == "BSDF_PRINCIPLED" and _only_diffuse(part):
        return part.colour("Base Color")
    return None


def glows(block: Any) -> bool:
    """Whether a material, lamp or world may give light of its own: a no is sure."""
    shader = read(block)
    return any(map(_shines, (*shader.surface, *shader.volume)))


def shines(block: Any) -> bool:
    """Whether the surface of a world or lamp may give light; what its volume does is not asked."""
    return any(map(_shines, read(block).surface))


def radiance(block: Any) -> tuple[float, float, float] | None:
    """Return what a world shines alike from everywhere, W/m^2/sr, or a lamp's nodes multiply it by; else None.

    Returns
    -------
    (float, float, float) or None
        None if it changes with direction or place, or cannot be known.
    """
    total = [0.0, 0.0, 0.0]
    for part in read(block).surface:
        if part.kind not in ("BACKGROUND", "EMISSION"):
            return None
        if not _shines(part):
            continue
        colour, strength = part.colour("Color"), part.inputs["Strength"]
        if colour is None or not isinstance(strength, float):
            return None
        total = [t + strength * c for t, c in zip(total, colour, strict=True)]
    return (total[0], total[1], total[2])


def level(block: Any) -> float:
    """Return a world's mean radiance, W/m^2/sr; of one with a texture, its strength; 0 if it gives no light."""
    total = 0.0
    for part in filter(_shines, read(block).surface):
        strength, colour = part.inputs.get("Strength"), part.colour("Color")
        power = strength if isinstance(strength, float) else 1.0
        total += abs(power * (sum(colour) / 3.0 if colour is not None else 1.0))
    return total


def darkened(world: bpy.types.World) -> bpy.types.World:
    """Return a copy of a world that gives no light from its surface; its volume is kept."""
    dark = world.copy()
    if not uses_nodes(dark):
        dark.color = (0.0, 0.0, 0.0)
        return dark
    tree = dark.node_tree
    for link in [k for k in tree.links if k.to_node.type == "OUTPUT_WORLD" and k.to_socket.name == "Surface"]:
        tree.links.remove(link)
    return dark


def kinds(material: Any) -> frozenset[str]:
    """Return in which ways a material may send light on: "diffuse", "glossy" and so on, as Cycles counts bounces.

    Parameters
    ----------
    material : bpy.types.Material or None

    Returns
    -------
    frozenset of str
        "mirror" beside "glossy" or "transmission" if it may do so in one direction only.
    """
    shader = read(material)
    found = {kind for part in shader.surface for kind in _kinds(part)}
    return frozenset(found | ({VOLUME} if shader.volume else set()))


def anchors(block: Any) -> set[bpy.types.Object]:
    """Return the objects in whose coordinates a material, lamp or world may look its textures up."""
    if not uses_nodes(block):
        return set()
    found: set[bpy.types.Object] = set()
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
                found.add(node.object)
    return found


def _flat(block: Any) -> Part:
    """What stands for the nodes that a block does not use."""
    if isinstance(block, bpy.types.World):
        return Part("BACKGROUND", {"Color": tuple(block.color), "Strength": 1.0})
    if isinstance(block, bpy.types.Light):
        return Part("EMISSION", {"Color": (1.0, 1.0, 1.0), "Strength": 1.0})
    return Part("BSDF_DIFFUSE", {"Color": tuple(block.diffuse_color)[:3], "Roughness": 0.0})


def _shines(part: Part) -> bool:
    """Whether a shader may give light: a no is sure."""
    if part.kind in ("EMISSION", "BACKGROUND"):
        return not (part.is_zero("Color") or part.is_zero("Strength"))
    if part.kind == "BSDF_PRINCIPLED":
        return not (part.is_zero("Emission Color") or part.is_zero("Emission Strength"))
    if part.kind == "PRINCIPLED_VOLUME":
        own = not (part.is_zero("Emission Color") or part.is_zero("Emission Strength"))
        return own or not part.is_zero("Blackbody Intensity")
    if part.kind == "VOLUME_COEFFICIENTS":
        return not part.is_zero("Emission Coefficients")
    return part.kind not in _DARK


def _thin(part: Part) -> bool:
    """Whether a volume is surely none."""
    return part.kind in ("VOLUME_ABSORPTION", "VOLUME_SCATTER") and part.is_zero("Density")


def _only_diffuse(part: Part) -> bool:
    weights = ("Metallic", "Specular IOR Level", "Transmission Weight", "Subsurface Weight", "Coat Weight")
    zero = (*weights, "Sheen Weight", "Diffuse Roughness", "Thin Film Thickness")
    return part.inputs.get("Alpha") == 1.0 and all(map(part.is_zero, zero)) and not _shines(part)


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
    ways = {
        "BSDF_GLOSSY": {GLOSSY},
        "BSDF_METALLIC": {GLOSSY},
        "BSDF_GLASS": {GLOSSY, TRANSMISSION},
        "BSDF_REFRACTION": {TRANSMISSION},
    }
    if part.kind not in ways:
        return {UNKNOWN}
    return ways[part.kind] | ({MIRROR} if _singular(part, "Roughness") else set())


def _principled(part: Part) -> set[str]:
    found = {DIFFUSE}
    if not all(map(part.is_zero, ("Metallic", "Specular IOR Level", "Transmission Weight"))):
        found |= {GLOSSY} | ({MIRROR} if _singular(part, "Roughness") else set())
    if not part.is_zero("Coat Weight"):
        found |= {GLOSSY} | ({MIRROR} if _singular(part, "Coat Roughness") else set())
    if not part.is_zero("Transmission Weight"):
        found.add(TRANSMISSION)
    if not part.is_zero("Subsurface Weight"):
        found.add(SUBSURFACE)
    if part.inputs.get("Alpha") != 1.0:
        found.add(TRANSPARENT)
    return found


def _singular(part: Part, name: str) -> bool:
    roughness = part.inputs.get(name)
    return not isinstance(roughness, float) or roughness < _SINGULAR


# --------------------------------------------------------------------------------------------------------------------
# Following the links
# --------------------------------------------------------------------------------------------------------------------

Path = tuple[Any, ...]
"""The group nodes that lead down to a tree, outermost first."""


@dataclass(frozen=True)
class _Origin:
    """Where a link begins: an output of a node, or a value that is the same everywhere."""

    node: Any = None
    output: Any = None
    path: Path = ()
    value: Value | None = None
    shader: bool = False


_NOWHERE = _Origin()
"""Connected, but to nothing: a group without a tree, what is too deep."""


@dataclass
class _Reader:
    """Follows links through reroutes, muted nodes and groups."""

    links: dict[int, dict[int, Any]] = field(default_factory=dict)

    def parts(self, socket: Any, path: Path) -> Iterator[Part]:
        """Return the shaders that a socket adds up to, each once."""
        todo, seen = [(socket, path)], set()
        while todo:
            origin = self.origin(*todo.pop())
            if origin is None or origin is _NOWHERE:
                continue
            if not origin.shader:  # Cycles lets a colour shine where a shader should be
                # (of a world, before Blender 5, a tenth of it)
                colour = origin.value if bpy.app.version >= (5, 0) else None
                yield Part("EMISSION", {"Color": colour, "Strength": 1.0}, frozenset({"Color"}))
                continue
            node, path = origin.node, origin.path
            key = (node.as_pointer(), *(group.as_pointer() for group in path))
            if key in seen:
                continue
            seen.add(key)
            if node.type == "MIX_SHADER":
                share = self.value(node.inputs[0], path)
                first, second = not isinstance(share, float) or share < 1.0, share is None or share > 0.0  # type: ignore[operator]
                todo += [(node.inputs[i], path) for i, counts in ((1, first), (2, second)) if counts]
            elif node.type == "ADD_SHADER":
                todo += [(each, path) for each in node.inputs]
            elif node.type != "EEVEE_SPECULAR":  # Cycles has no such thing
                yield self._part(node, path)

    def _part(self, node: Any, path: Path) -> Part:
        inputs = [s for s in node.inputs if s.enabled and not getattr(s, "is_unavailable", False)]
        origins = {s.name: self.origin(s, path) for s in inputs}
        images = {name: getattr(o.node, "image", None) for name, o in origins.items() if o is not None}
        return Part(
            kind=node.type,
            inputs={s.name: self.value(s, path) for s in inputs},
            linked=frozenset(name for name, origin in origins.items() if origin is not None),
            component=str(getattr(node, "component", "")),
            images={name: image for name, image in images.items() if image is not None},
        )

    def value(self, socket: Any, path: Path) -> Value | None:
        """Return what a socket is given if that is the same everywhere, else None."""
        origin = self.origin(socket, path)
        if origin is None:
            return _default(socket)
        if origin is _NOWHERE or origin.value is None:
            return None
        return _as(socket.type, origin.value)

    def origin(self, socket: Any, path: Path) -> _Origin | None:
        """Return where the link into a socket begins; None if it is as good as unlinked."""
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
                    return _Origin(value=0.0)  # later Blenders take it for unlinked
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
        """The link into a socket that counts."""
        tree = socket.id_data
        key = tree.as_pointer()
        if key not in self.links:
            self.links[key] = {
                link.to_socket.as_pointer(): link
                for link in tree.links
                if link.is_valid and not link.is_muted and link.from_socket.enabled and link.to_socket.enabled
            }
        return self.links[key].get(socket.as_pointer())


def _group_output(node: Any, output: Any) -> Any:
    """The socket inside a group that an output of it stands for, or None."""
    tree = node.node_tree
    ends = [n for n in tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output] if tree else []
    return next((s for end in ends for s in end.inputs if s.identifier == output.identifier), None)


def _default(socket: Any) -> Value | None:
    value = getattr(socket, "default_value", None)
    if value is None or isinstance(value, str):
        return None
    if isinstance(value, (bool, int, float)):
        return float(value)
    return tuple(float(v) for v in value)


def _as(kind: str, value: Value) -> Value:
    """Turn a value into what a socket of that kind makes of it."""
    if kind in ("RGBA", "VECTOR"):
        width = 4 if kind == "RGBA" else 3
        whole = (value,) * 3 if isinstance(value, float) else value
        return (*whole[:3], 1.0)[:width]
    if isinstance(value, float):
        return value
    if len(value) == 4:
        return sum(w * v for w, v in zip(_LUMINANCE, value, strict=False))
    return sum(value) / 3.0
