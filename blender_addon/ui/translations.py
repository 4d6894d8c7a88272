"""Translations of the user interface. Texts that are missing here appear in English."""

import bpy

_GERMAN = {
    ("*", "Scene"): "Szene",
    ("*", "Target"): "Ziel",
    ("*", "Light"): "Licht",
    ("*", "Ambient Light"): "Umgebungslicht",
    ("*", "Hidden Voxels"): "Verborgene Voxel",
    ("*", "Rendering"): "Rendern",
    ("*", "Check"): "Prüfen",
    ("*", "Look"): "Hinsehen",
    ("*", "Live Look"): "Mitlaufendes Bild",
    ("*", "Data Set"): "Datensatz",
    ("*", "Answer"): "Antwort",
    ("*", "Adopt My Objects"): "Eigene Objekte verwenden",
    ("*", "Reflections"): "Reflexionen",
    ("*", "Poses"): "Lagen",
    ("*", "Processes"): "Prozesse",
    ("*", "Accuracy"): "Genauigkeit",
    ("*", "Half Angle"): "Halber Winkel",
    ("*", "Albedo"): "Albedo",
    ("Operator", "Build Scene"): "Szene bauen",
    ("Operator", "Apply to Scene"): "Auf Szene anwenden",
    ("Operator", "Read from Scene"): "Aus Szene lesen",
    ("Operator", "Check Scene"): "Szene prüfen",
    ("Operator", "Render Wall"): "Wand rendern",
    ("Operator", "Render Data Set"): "Datensatz rendern",
    ("Operator", "Resume"): "Fortsetzen",
    ("Operator", "Open Image Editor"): "Bildeditor öffnen",
    ("Operator", "Where Is It?"): "Wo steht es?",
}


def register() -> None:
    """Register the translations with Blender."""
    bpy.app.translations.register(__package__ or __name__, {"de_DE": _GERMAN, "de": _GERMAN})


def unregister() -> None:
    """Unregister the translations."""
    bpy.app.translations.unregister(__package__ or __name__)
