"""Says the messages that the command line says too in words of the panels: an option is a setting's label there."""

from __future__ import annotations

import re

SETTINGS = "Rendering > Settings"

_PHRASES: tuple[tuple[str, str], ...] = (
    # Ways out that the panels do not have, for what they show cannot come to that, or must be mended.
    (r"[,;] (?:or )?allow it with --trust-links", ""),
    (r", or render it all the same with --no-probe", ""),
    (r"(?:, or )?smaller turns \(--rotation 0 0 0\)", ""),
    (r", or use --hyperparameters paper", ""),
    (r" or --repeats\b", ""),
    (r"; finish the sweep, or take it as it is with --partial", "; Resume renders the others"),
    (r"mend that, or begin the set in spite of it with --force", "Check shows it, and what would mend it"),
    # What a panel says by a button.
    (r"\(and (\w+) more, see nlos-generate check\)", r"(and \1 more, which Check shows)"),
    (r"[Rr]un nlos-generate (\w+) again", r"run nlos-generate \1 in a shell again"),
    (r"make one with nlos-generate trajectory", "make one by Timeline > Render Timeline"),
    (r"make one with 'make setup'", "Make Environment makes one that has it"),
    (r"nlos-generate bulk SCENE\.blend -o SET --inside centre, then ", "Data Set > Inside > Its Centre, then "),
    (r"nlos-classify atlas SET -o FILE\.atlas", "nlos-classify atlas in a shell"),
    (r"track follows one made without --unknown", "Follow takes one of a known object"),
    (r"take fewer --frames", "take fewer frames"),
    (r"--inside centre", "Data Set > Inside > Its Centre"),
    (r"--inside whole", "Data Set > Inside > Whole Object"),
    (r"\(target\.unit, --target-unit: [^)]*\)", "(Target > Unit)"),
    (r"target\.unit \(--target-unit: [^)]*\)", "Target > Unit"),
    (r"only --engine (\w+)", r"only the engine \1"),
    (r"(?:use|take) --engine (\w+)", rf"take the engine \1 ({SETTINGS})"),
)

LABELS = {
    "--accuracy": "Error",
    "--budget": "Minutes",
    "--device": "Device",
    "--denoise": "Denoise",
    "--engine": "Engine",
    "--inside": "Inside",
    "--poses": "Poses a Voxel",
    "--resolution": "Resolution",
    "--samples": "Samples",
    "--seed": "Seed",
}
"""Labels of the panels, by the option of the command line."""

_FIELDS = {
    "target.kind": "Target > Kind",
    "target.size": "Target > Size",
    "target.albedo": "Target > Albedo",
    "target.mesh": "Target > File",
    "target.unit": "Target > Unit",
    "target.up": "Target > Up",
    "spot.power": "Light > Power",
    "spot.half_angle": "Light > Half Angle",
    "grid.shape": "Hidden Voxels > Voxels",
    "grid.lo": "Hidden Voxels > From",
    "grid.hi": "Hidden Voxels > To",
}
"""Labels of the panels, by the name in a scene file."""

_IDLE = re.compile(r"(?:--|\b)(samples|accuracy)(?=:? means nothing to)")
_FIELD = re.compile(r"(?<![\w./])(" + "|".join(map(re.escape, _FIELDS)) + r")(?![\w.]\w)")
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def shown(text: str) -> str:
    """Return a message in the panels' words.

    An option of which no panel has a setting stays as it is: what is said of it is said of a shell.
    """
    for pattern, words in _PHRASES:
        text = re.sub(pattern, words, text)
    text = _IDLE.sub(lambda found: found[1].title(), text)
    text = _FIELD.sub(lambda found: _FIELDS[found[1]], text)
    return _OPTION.sub(lambda found: LABELS.get(found[0], found[0]), text)
