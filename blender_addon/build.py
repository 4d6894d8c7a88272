"""Builds the extension: ``python -m blender_addon.build -o DIST``.

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

from blender_addon import sbom

_ADDON = Path(__file__).resolve().parent
_ROOT = _ADDON.parent
_TOOLS = ("build", "sbom")
"""What builds stays out of what is built."""
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
    inside = folder / "generator"
    inside.mkdir(parents=True)
    shutil.copy(_ADDON / "blender_manifest.toml", folder)
    shutil.copy(_licence(), folder)
    modules = [source for source in sorted(_ADDON.glob("*.py")) if source.stem not in _TOOLS]
    # `worker` is run by name, in a Blender of its own.
    needed = {"__init__", "worker"}.union(*(_copy(source, folder / source.name, ".generator") for source in modules))
    done: set[str] = set()
    while needed - done:
        name = min(needed - done)
        source = _ROOT / "generator" / f"{name}.py"
        package = source.with_suffix("")
        if package.is_dir():
            (inside / name).mkdir()
            for module in sorted(package.glob("*.py")):
                needed |= _copy(module, inside / name / module.name, "..")
        elif source.is_file():
            needed |= _copy(source, inside / source.name, ".")
        else:
            raise BuildError(f"{source}: there is no such module, but the add-on needs it")
        done.add(name)
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


def _copy(source: Path, copy: Path, generator: str) -> set[str]:
    """Copy a module with `generator` imported by a relative name; return which modules of it are imported.

    That name is ``.generator`` in the add-on, ``.`` in `generator` itself and ``..`` in a package inside it.
    """
    text = source.read_text(encoding="utf-8")
    needed = set()
    tree = ast.parse(text)
    typing = [
        node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    idle = {inner for node in typing for inner in ast.walk(node)}  # for the type checker's eyes only
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and not node.level and node.module and node not in idle:
            top, _, inner = node.module.partition(".")
            if top == "generator":
                needed |= {inner.partition(".")[0]} if inner else {alias.name for alias in node.names}
    relative = _IMPORT.sub(lambda m: f"{m[1]}from {generator}{_dotted(generator, m[2])} import ", text)
    for node in ast.walk(ast.parse(relative)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        if any(name.partition(".")[0] == "generator" for name in names):
            raise BuildError(f"{source}: line {ast.unparse(node)!r} must read 'from generator... import ...'")
    copy.write_text(relative, encoding="utf-8")
    return needed


def _dotted(generator: str, inner: str) -> str:
    return inner if generator == ".generator" else inner.removeprefix(".")


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
    parser = argparse.ArgumentParser(prog="python -m blender_addon.build", description="Build the Blender extension.")
    parser.add_argument("-o", "--output", type=Path, default=Path("dist"), metavar="DIST", help="folder for the zip")
    try:
        print(build(parser.parse_args().output))
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
