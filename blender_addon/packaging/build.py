"""Builds the extension: ``python -m blender_addon.packaging.build -o DIST``.

Blender has no pip, so the zip carries the modules of `generator` that the add-on needs. An extension must not reach
for top-level names, so imports of `generator` become relative on the way. Blender's own extension tool, from the bpy
wheel, makes the zip and checks it. The same sources give the same zip, byte by byte, wherever it is built.
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
from pathlib import Path

from . import sbom

_HERE = Path(__file__).resolve().parent
"""What builds stays out of what is built."""
_ADDON = _HERE.parent
_ROOT = _ADDON.parent
_RUN_BY_NAME = Path("generator", "blender", "worker.py")
"""Imported by no module: it runs in a Blender of its own."""
_IMPORT = re.compile(r"^(\s*)from generator((?:\.\w+)*) import ", re.MULTILINE)


class BuildError(Exception):
    """The extension cannot be built, and why."""


def build(folder: Path) -> Path:
    """Build and check the extension.

    Parameters
    ----------
    folder : Path
        Where the zip goes; made if need be.

    Returns
    -------
    Path
        The zip.

    Raises
    ------
    BuildError
        The bpy wheel is not installed, its tool refuses the extension, an import cannot be made relative, or there is
        no LICENSE.
    """
    tool = _extension_tool()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="nlos-extension-") as temporary:
        assembled, made = Path(temporary, "nlos_lab"), Path(temporary, "zip")
        made.mkdir()
        assemble(assembled)
        _run(tool, "build", "--source-dir", str(assembled), "--output-dir", str(made))
        [loose] = made.glob("*.zip")
        package = folder / loose.name
        _settle(loose, package)
        _run(tool, "validate", str(package))
        return package


def assemble(folder: Path) -> None:
    """Write the extension's files, imports made relative, into a new folder."""
    folder.mkdir(parents=True)
    shutil.copy(_ADDON / "blender_manifest.toml", folder)
    shutil.copy(_licence(), folder)
    needed = {_RUN_BY_NAME}
    for source in sorted(_ADDON.rglob("*.py")):
        if source.parent != _HERE:
            needed |= _copy(source, folder, source.relative_to(_ADDON))
    done: set[Path] = set()
    while needed - done:
        module = min(needed - done)
        needed |= _copy(_ROOT / module, folder, module)
        done.add(module)
    (folder / sbom.NAME).write_text(sbom.extension(folder), encoding="utf-8")


def _licence() -> Path:
    """Return the licence's text: beside the sources, or where the wheel has put it."""
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
    """Write a zip anew without what differs between two builds: order, dates and permissions of its files."""
    with zipfile.ZipFile(loose) as old, zipfile.ZipFile(package, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as new:
        for name in sorted(old.namelist()):
            entry = zipfile.ZipInfo(name)  # of 1980
            entry.external_attr = 0o100644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            new.writestr(entry, old.read(name))


def _copy(source: Path, folder: Path, place: Path) -> set[Path]:
    """Copy a module to its place in a folder, `generator` imported by a relative name.

    Returns
    -------
    set of Path
        Files of `generator` that it imports, relative to the project; the packages that they lie in too.
    """
    text = source.read_text(encoding="utf-8")
    tree = ast.parse(text)
    typing = [
        node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    idle = {inner for node in typing for inner in ast.walk(node)}  # for the type checker's eyes only
    needed: set[Path] = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or node.level or node in idle:
            continue
        if str(node.module).partition(".")[0] == "generator":
            needed |= _files(source, node)
    relative = _IMPORT.sub(lambda m: f"{m[1]}from {'.' * len(place.parts)}generator{m[2]} import ", text)
    for node in ast.walk(ast.parse(relative)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        if any(name.partition(".")[0] == "generator" for name in names):
            raise BuildError(f"{source}: line {ast.unparse(node)!r} must read 'from generator... import ...'")
    (folder / place).parent.mkdir(parents=True, exist_ok=True)
    (folder / place).write_text(relative, encoding="utf-8")
    return needed


def _files(source: Path, node: ast.ImportFrom) -> set[Path]:
    """Return the files of `generator` that an import reads, relative to the project."""
    parts = str(node.module).split(".")
    found = {Path(*parts[:depth], "__init__.py") for depth in range(1, len(parts))}
    package = Path(*parts)
    if (_ROOT / package).is_dir():
        modules = {package / f"{alias.name}.py" for alias in node.names}
        packages = {package / alias.name / "__init__.py" for alias in node.names}
        inside = {file for file in modules | packages if (_ROOT / file).is_file()}
        return found | inside | {package / "__init__.py"}
    if not (_ROOT / package.with_suffix(".py")).is_file():
        raise BuildError(f"{source}: there is no module {node.module}, but the add-on needs it")
    return found | {package.with_suffix(".py")}


def _extension_tool() -> Path:
    found = importlib.util.find_spec("bpy")  # does not import it
    if found is None or found.origin is None:
        raise BuildError("the bpy wheel is not installed; its extension tool makes the zip: pip install bpy")
    tools = sorted(Path(found.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not tools:
        raise BuildError(f"the bpy wheel at {found.origin} has no extension tool (addons_core/bl_pkg)")
    return tools[-1]


def _run(tool: Path, *arguments: str) -> None:
    done = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"blender_ext.py {arguments[0]} failed:\n{done.stdout}{done.stderr}".rstrip())


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
