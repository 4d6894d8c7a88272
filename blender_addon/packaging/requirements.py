"""The packages of the Python that the extension makes: ``python -m blender_addon.packaging.requirements``.

Writes ``blender_addon/requirements.txt``: the project's dependencies and theirs, as ``constraints.txt`` pins them.
"""

from __future__ import annotations

import re
import sys
import tomllib
from importlib.metadata import requires
from pathlib import Path

from ..session.making import REQUIREMENTS

_ADDON = Path(__file__).resolve().parents[1]
_ROOT = _ADDON.parent
_NAME = re.compile(r"[\w.-]+")


def text() -> str:
    """Return what the file must hold; the project's dependencies must be installed."""
    project = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    markers = {_name(line): line.partition(";")[2] for line in project["dependencies"]}
    reached, left = set(markers), set(markers)
    lines = []
    pins = [line for line in (_ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    pinned = {_name(pin) for pin in pins}
    while left:
        found = {_name(line) for line in requires(left.pop()) or () if "extra ==" not in line} & pinned
        left |= found - reached
        reached |= found
    for pin in pins:
        marker = markers.get(_name(pin), "")
        if _name(pin) in reached:
            lines.append(f"{pin};{marker}" if marker and ";" not in pin else pin)
    return "\n".join(lines) + "\n"


def _name(requirement: str) -> str:
    found = _NAME.match(requirement)
    return re.sub(r"[-_.]+", "-", found[0]).lower() if found else ""


def main() -> int:
    """Write the file."""
    (_ADDON / REQUIREMENTS).write_text(text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
