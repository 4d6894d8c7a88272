"""Bills of materials: ``python -m blender_addon.packaging.sbom [-o FILE]``.

The bill of the extension lists the contents of its zip; that of an environment lists the installed packages, each
with version, licence and origin. The format is CycloneDX JSON without its optional serial number and time stamp, so
that the same content gives the same bill.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
import tomllib
import zipfile
from collections.abc import Iterable, Mapping
from importlib.metadata import Distribution, PathDistribution, distributions
from pathlib import Path
from typing import Any

NAME = "sbom.cdx.json"
"""File name of the extension's bill, inside its zip."""

_APPROVED = "License :: OSI Approved :: "
_SHORT = 80
"""Length limit of a licence's name: some packages put the whole licence text in its place."""


def extension(folder: Path) -> str:
    """Return the bill of materials of an extension.

    Parameters
    ----------
    folder : Path
        Files of the extension, including ``blender_manifest.toml``. Wheels are listed as packages.

    Returns
    -------
    str
        JSON.
    """
    manifest = tomllib.loads((folder / "blender_manifest.toml").read_text(encoding="utf-8"))
    [licence] = manifest["license"]
    component = {
        "type": "application",
        "bom-ref": manifest["id"],
        "name": manifest["id"],
        "version": manifest["version"],
        "licenses": [{"expression": licence.removeprefix("SPDX:")}],
    }
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != folder / NAME)
    return _bill(component, [_file(path, path.relative_to(folder).as_posix()) for path in files])


def environment(found: Iterable[Distribution], whole: str = "nlos-lab") -> str:
    """Return the bill of materials of the installed packages.

    Parameters
    ----------
    found : iterable of Distribution
        Installed packages.
    whole : str, default: "nlos-lab"
        Name of the main package, which the others are installed for.

    Returns
    -------
    str
        JSON.
    """
    packages = {package["name"]: package for package in map(_package, found)}
    top = packages.pop(whole, {"name": whole})
    return _bill({**top, "type": "application"}, [packages[name] for name in sorted(packages)])


def table(bill: str) -> str:
    """Return a bill's packages as readable text: name, version and licence, one line per package."""
    rows = [(part["name"], part.get("version", ""), _words(part)) for part in json.loads(bill)["components"]]
    widths = [max((len(row[column]) for row in rows), default=0) for column in (0, 1)]
    return "".join(f"{a:<{widths[0]}}  {b:<{widths[1]}}  {c}\n" for a, b, c in rows)


def _bill(whole: Mapping[str, Any], parts: list[dict[str, Any]]) -> str:
    bill = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": dict(whole)},
        "components": parts,
    }
    return json.dumps(bill, indent=1, ensure_ascii=False) + "\n"


def _file(path: Path, name: str) -> dict[str, Any]:
    hashes = [{"alg": "SHA-256", "content": hashlib.sha256(path.read_bytes()).hexdigest()}]
    if path.suffix != ".whl":
        return {"type": "file", "name": name, "hashes": hashes}
    with zipfile.ZipFile(path) as archive:
        [dist_info] = {entry.partition("/")[0] for entry in archive.namelist() if ".dist-info/" in entry}
        return {**_package(PathDistribution(zipfile.Path(archive, f"{dist_info}/"))), "hashes": hashes}


def _package(found: Distribution) -> dict[str, Any]:
    name = re.sub(r"[-_.]+", "-", found.metadata["Name"]).lower()
    address = f"pkg:pypi/{name}@{found.version}"
    part = {"type": "library", "bom-ref": address, "name": name, "version": found.version, "purl": address}
    licences = _licences(found)
    return {**part, "licenses": licences} if licences else part


def _licences(found: Distribution) -> list[dict[str, Any]]:
    """Return the licences that a package's metadata state: by name, or else as the text in the package."""
    metadata: Any = found.metadata
    if expression := metadata.get("License-Expression"):
        return [{"expression": expression}]
    lines = (metadata.get("License") or "").strip().splitlines()
    if len(lines) == 1 and lines[0] != "UNKNOWN" and len(lines[0]) < _SHORT:
        return [{"license": {"name": lines[0]}}]
    approved = [c.removeprefix(_APPROVED) for c in metadata.get_all("Classifier") or [] if c.startswith(_APPROVED)]
    if approved:
        return [{"license": {"name": name}} for name in approved]
    files = [file for file in found.files or [] if ".dist-info" in file.parts[0] and "licen" in file.name.lower()]
    texts = [(file.name, found.read_text("/".join(file.parts[1:]))) for file in files]
    return [{"license": {"name": name, "text": {"content": text}}} for name, text in texts if text]


def _words(part: Mapping[str, Any]) -> str:
    names = []
    for item in part.get("licenses", []):
        licence = item.get("license", {})
        names.append(f"see its {licence['name']}" if "text" in licence else item.get("expression") or licence["name"])
    return ", ".join(names) or "not told"


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m blender_addon.packaging.sbom",
        description="List what is installed beside this package, with licences.",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="for CycloneDX's JSON")
    options = parser.parse_args()
    bill = environment(distributions())
    if options.output:
        options.output.write_text(bill, encoding="utf-8")
    print(table(bill), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
