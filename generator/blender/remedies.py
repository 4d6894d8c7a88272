"""What would mend what engines cannot honour: findings for the phrases of `engines.survey`."""

from __future__ import annotations

import re

import bpy

from generator.blender.finding import Finding

_DIFFUSE = "give it a material of one Diffuse BSDF"
_VISIBLE = "tick all of its Object > Visibility > Ray Visibility"
_REMEDIES: tuple[tuple[str, str, str], ...] = (
    (r"no material|not one constant colour|only Cycles knows|displaces it|has a glossy material", _DIFFUSE, ""),
    (r"filled with a volume|fills it with a volume", "take the volume out of it, or hide it from renders", ""),
    (r"light of its own|gives negative light", f"{_DIFFUSE}, without emission", ""),
    (r"colour is not between 0 and 1", "give it a colour from 0 to 1", ""),
    (r"more than one colour where", "give the part in view one Diffuse BSDF of one colour", ""),
    (r"empty material slot", "put a material into the slot, or remove the slot", ""),
    (r"shaded smooth", "shade it flat (Object > Shade Flat)", ""),
    (r"has a radius of", "set the lamp's Radius to 0", ""),
    (r"is not a spot lamp", "use a spot lamp (lamp's data > Type)", ""),
    (r"neither a point nor an area|spread is not 180", "make it a point or an area lamp of 180°, or hide it", ""),
    (r"moves with the target|when the target (does|moves)|where it stands|changes when", "take that link away", ""),
    (r"shader nodes of its own that", "take away the lamp's nodes (Use Nodes)", ""),
    (r"colour from a temperature", "untick the lamp's Temperature", ""),
    (r"not normalised", "tick the lamp's Normalize", ""),
    (r"scaled unevenly", "apply its scale (Object > Apply > Scale)", ""),
    (r"casts no shadows", "tick the lamp's Shadow", ""),
    (r"limit of bounces of its own", "set its own Max Bounces to 1024", ""),
    (r"light linking", "empty its light linking (Object > Shading)", ""),
    (r"once more, as an instance", "delete that instance", ""),
    (r"is not visible to .* rays", _VISIBLE, ""),
    (r"holdout|seen indirectly only|shadow catcher", "untick that in Object > Visibility or in its collection", ""),
    (r"shadow terminator offset", "set Object > Shading > Shadow Terminator to 0", ""),
    (r"like a mirror", "raise its material's Roughness, or hide the other light", ""),
    (r"glossy roughness", "raise its material's Roughness", ""),
    (r"reflection order of 3", "follow three reflections", "reflections"),
    (r"followed in the spot's light", f"hide the other light, or {_DIFFUSE}", ""),
    (r"transparent bounces", "raise Render > Light Paths > Transparent", ""),
    (r"limit of \w+ bounces", "set the limits in Render > Light Paths to that of all", ""),
    (r"surfel knows only faces|carries hair", "convert it to a mesh (Object > Convert), or hide it from renders", ""),
    (r"not a finite number", "mend or delete that corner", ""),
    (r"neither perspective nor orthographic", "set the camera's Type to Perspective or Orthographic", ""),
    (r"depth of field", "untick the camera's Depth of Field", ""),
    (r"clips the relay wall", "set the camera's Clip Start below and Clip End above the wall's distance", ""),
    (r"sees beyond", "turn or move the camera, or narrow its view (Focal Length, Orthographic Scale)", ""),
    (r"stands between|stands in the cone", "move it out of the way", ""),
    (r"misses the plane|grazes the wall", "turn the lamp to the wall, or narrow its Spot Size", ""),
    (r"opposite sides of the wall", "put lamp and camera on one side of it", ""),
    (r"is hidden from renders|has no surface", "show it in renders (camera icon in the Outliner)", ""),
    (r"on one another", "move them apart, or delete one", ""),
    (r"surfaces are more|has \d+ triangles", "simplify it (Decimate), or follow three reflections", "reflections"),
    (r"triangles give light", "make what gives light of fewer faces", ""),
    (r"view layers? ", "mend that in View Layer", ""),
    (r"ambient light that is not", "give the world one Background of one colour", ""),
)
"""Pattern of a phrase, what would mend it, and the key of `finding.FIXES` that does, if one does."""


def named(scene: bpy.types.Scene, text: str) -> str:
    """Return the first object of the scene that a sentence names; empty if there is none."""
    names = (one or other for one, other in re.findall(r"""'([^']*)'|"([^"]*)\"""", text))
    return next((name for name in names if name in scene.objects), "")


def remedy(why: str) -> tuple[str, str]:
    """Return what would mend what a phrase says, and the key of the fix that does; empty where that is not known."""
    said = why.replace(", which moves with the target,", "")  # part of a name
    return next(((words, fix) for pattern, words, fix in _REMEDIES if re.search(pattern, said)), ("", ""))


def finding(scene: bpy.types.Scene, level: str, why: str, text: str = "{}") -> Finding:
    """Return a finding about what a phrase says, with the object, its materials and what would mend it.

    Parameters
    ----------
    scene : bpy.types.Scene
    level : str
    why : str
        Phrase of a survey.
    text : str
        The finding's text, with braces where the phrase stands.
    """
    name, (words, fix) = named(scene, why), remedy(why)
    if "material" in why and "no material" not in why and "material (" not in why:
        why += _of(scene, name)
    sentence = text.format(f"{why}: {words}" if words else why)
    return Finding(level, sentence[:1].upper() + sentence[1:], name, fix)


def _of(scene: bpy.types.Scene, name: str) -> str:
    """Return the names of an object's materials, in brackets."""
    slots = scene.objects[name].material_slots if name else ()
    names = list(dict.fromkeys(repr(slot.material.name) for slot in slots if slot.material is not None))
    return f" ({', '.join(names[:3])}{' ...' if len(names) > 3 else ''})" if names else ""
