"""Builds the extension: ``python -m blender_addon.packaging.build -o DIST``.

Blender has no pip, so the zip carries the modules of `generator` that the add-on needs. An extension must not import
top-level packages, so its imports of `generator` are made relative. `classify`, which Blender never imports, goes in
as it is: the Python that the extension makes (`session.making`) finds both in the extension's folder. Blender's own
extension tool, from the bpy wheel, makes the zip and checks it. The same sources give the same zip, byte by byte,
wherever it is built.
"""

from __future__ import annotations

import argparse
import ast
import importlib.metadata
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path

from ..session.making import REQUIREMENTS
from . import sbom

_HERE = Path(__file__).resolve().parent
"""This folder is left out of the extension."""
_ADDON = _HERE.parent
_ROOT = _ADDON.parent
_RUN_BY_NAME = {Path("generator", "blender", "worker.py"), Path("generator", "jobs", "look_worker.py")}
"""Modules that no other imports: they are run by name, in a separate process."""
_IMPORT = re.compile(r"^(\s*)from generator((?:\.\w+)*) import ", re.MULTILINE)


class BuildError(Exception):
    """Raised with the reason why the extension cannot be built."""


def build(folder: Path) -> Path:
    """Build and check the extension.

    Parameters
    ----------
    folder : Path
        Folder for the zip; created if it is missing.

    Returns
    -------
    Path
        Path of the zip.

    Raises
    ------
    BuildError
        The bpy wheel is not installed, its tool refuses the extension, an import cannot be made relative, or there is
        no LICENSE.
    """
    tool = _extension_tool()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="nlos-extension-") as temporary:
        assembled, output = Path(temporary, "nlos_lab"), Path(temporary, "zip")
        output.mkdir()
        assemble(assembled)
        _run(tool, "build", "--source-dir", str(assembled), "--output-dir", str(output))
        [built] = output.glob("*.zip")
        package = folder / built.name
        _settle(built, package)
        _run(tool, "validate", str(package))
        return package


def assemble(folder: Path) -> None:
    """Write the extension's files, with their imports made relative, into a new folder."""
    folder.mkdir(parents=True)
    shutil.copy(_ADDON / "blender_manifest.toml", folder)
    shutil.copy(_licence(), folder)
    shutil.copy(_ADDON / REQUIREMENTS, folder)
    for source in _addon():
        _copy(source, folder, source.relative_to(_ADDON))
    beside = [path for path in sorted((_ROOT / "classify").rglob("*")) if path.suffix in (".py", ".html")]
    for source in beside:
        place = folder / source.relative_to(_ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, place)
    for module in in_blender() | _reached(path for path in beside if path.suffix == ".py"):
        _copy(_ROOT / module, folder, module)
    (folder / sbom.NAME).write_text(sbom.extension(folder), encoding="utf-8")


def in_blender() -> set[Path]:
    """Return the files of `generator` that the add-on needs, relative to the project; `classify` needs more."""
    return _reached([*_addon(), *(_ROOT / module for module in _RUN_BY_NAME)]) | _RUN_BY_NAME


def _addon() -> list[Path]:
    return [source for source in sorted(_ADDON.rglob("*.py")) if source.parent != _HERE]


def _reached(sources: Iterable[Path]) -> set[Path]:
    """Return the files of `generator` that modules import, themselves or by others, relative to the project."""
    left = {module for source in sources for module in _needed(source)}
    found: set[Path] = set()
    while left:
        module = left.pop()
        found.add(module)
        left |= _needed(_ROOT / module) - found
    return found


def _licence() -> Path:
    """Return the path of the licence: in the source tree, or where the wheel has installed it."""
    if (_ROOT / "LICENSE").is_file():
        return _ROOT / "LICENSE"
    try:
        files = importlib.metadata.files("nlos-lab") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    for file in files:
        if file.name == "LICENSE":
            return Path(str(file.locate()))
    raise BuildError(f"there is no LICENSE in {_ROOT}, but the extension must hold it")


def _settle(loose: Path, package: Path) -> None:
    """Rewrite a zip with fixed order, dates and permissions of its files, which would differ between two builds."""
    with zipfile.ZipFile(loose) as old, zipfile.ZipFile(package, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as new:
        for name in sorted(old.namelist()):
            entry = zipfile.ZipInfo(name)  # dated 1980 by default
            entry.external_attr = 0o100644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            new.writestr(entry, old.read(name))


def _copy(source: Path, folder: Path, place: Path) -> None:
    """Copy a module to its place in a folder, with its imports of `generator` made relative."""
    text = source.read_text(encoding="utf-8")
    if place.parts[0] == "generator":  # relative within it, so that it is a package by itself as well
        relative = _IMPORT.sub(lambda m: f"{m[1]}from {'.' * (len(place.parts) - 1)}{m[2][1:]} import ", text)
    else:
        relative = _IMPORT.sub(lambda m: f"{m[1]}from {'.' * len(place.parts)}generator{m[2]} import ", text)
    for node in ast.walk(ast.parse(relative)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        if any(name.partition(".")[0] == "generator" for name in names):
            raise BuildError(f"{source}: line {ast.unparse(node)!r} must read 'from generator... import ...'")
    (folder / place).parent.mkdir(parents=True, exist_ok=True)
    (folder / place).write_text(relative, encoding="utf-8")


def _needed(source: Path) -> set[Path]:
    """Return the files of `generator` that a module imports when it is run, and of the packages that contain them.

    Relative to the project.
    """
    tree = ast.parse(source.read_text(encoding="utf-8"))
    type_checking = [
        node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    idle = {inner for node in type_checking for inner in ast.walk(node)}  # imports for the type checker only
    needed: set[Path] = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or node.level or node in idle:
            continue
        if str(node.module).partition(".")[0] == "generator":
            needed |= _files(source, node)
    return needed


def _files(source: Path, node: ast.ImportFrom) -> set[Path]:
    """Return the files of `generator` that an import reads, relative to the project."""
    parts = str(node.module).split(".")
    package_files = {Path(*parts[:depth], "__init__.py") for depth in range(1, len(parts))}
    package = Path(*parts)
    if (_ROOT / package).is_dir():
        modules = {package / f"{alias.name}.py" for alias in node.names}
        packages = {package / alias.name / "__init__.py" for alias in node.names}
        imported = {file for file in modules | packages if (_ROOT / file).is_file()}
        return package_files | imported | {package / "__init__.py"}
    if not (_ROOT / package.with_suffix(".py")).is_file():
        raise BuildError(f"{source}: there is no module {node.module}, but the add-on needs it")
    return package_files | {package.with_suffix(".py")}


def _extension_tool() -> Path:
    spec = importlib.util.find_spec("bpy")  # does not import it
    if spec is None or spec.origin is None:
        raise BuildError("the bpy wheel is not installed; its extension tool makes the zip: pip install bpy")
    tools = sorted(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not tools:
        raise BuildError(f"the bpy wheel at {spec.origin} has no extension tool (addons_core/bl_pkg)")
    return tools[-1]


def _run(tool: Path, *arguments: str) -> None:
    result = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False)
    if result.returncode:
        raise BuildError(f"blender_ext.py {arguments[0]} failed:\n{result.stdout}{result.stderr}".rstrip())


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m blender_addon.packaging.build", description="Build the Blender extension."
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("dist"), metavar="DIST", help="folder for the zip")
    try:
        print(build(parser.parse_args().output))
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
