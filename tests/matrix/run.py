"""Build everything twice, and use it under every Python and Blender there is: ``python tests/matrix/run.py``.

Wheel, sdist and extension are built in surroundings that differ, and compared. Then each row installs the wheel alone
into a clean environment, far from the sources, and goes from a scene to an answer; the row without Blender trains on
what the others have rendered. Their pictures are compared, and every bill of materials is validated.

Prints a table and writes it to ``--output``. Ends with 1 if anything failed or could not be run, and with 2 if the
machine lacks what all of it needs. What every command said is in the logs beside the table.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import builds
import chain
import pictures
import places
from packaging.requirements import Requirement

from blender_addon.packaging import sbom
from generator.model.errors import NlosError

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
GOOD = "good"
HEAD = ("row", "Python", "bpy", "what ran", "seconds", "result")
VALIDATE = """
import sys
from pathlib import Path
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
faults = {path: JsonStrictValidator(SchemaVersion.V1_6).validate_str(Path(path).read_text()) for path in sys.argv[1:]}
sys.exit("; ".join(f"{path}: {fault}" for path, fault in faults.items() if fault) or 0)
"""


@dataclass(frozen=True)
class Row:
    """A Python and a Blender; ``bpy`` is what constraints.txt pins for that Python where it is left out."""

    python: str
    bpy: str | None = None
    blender: bool = True

    @property
    def name(self) -> str:
        """For folders and on the command line."""
        return f"{self.python}-{self.bpy or ('pinned' if self.blender else 'none')}"

    @property
    def version(self) -> str:
        """Of bpy, or "none"."""
        found = [pin.partition("==")[2] for pin in pinned(self.python, self.bpy) if pin.startswith("bpy==")]
        return found[0] if self.blender else "none"


ROWS = (Row("3.11", "4.5.15"), Row("3.11"), Row("3.13"), Row("3.13", "5.3.0"), Row("3.11", blender=False))
REFERENCE = ROWS[1]


class FailedError(Exception):
    """Something is not as it must be."""


class Matrix:
    """The whole run, and its table."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.output: Path = arguments.output.resolve()
        self.table: list[tuple[str, ...]] = []
        self.made: dict[str, Path] = {}
        self.rendered: dict[Row, Path] = {}
        self.bills: list[Path] = []

    @property
    def good(self) -> bool:
        """Whether all there is was run and did what it must."""
        return all(line[-1].startswith(GOOD) for line in self.table)

    def run(self, rows: Sequence[Row]) -> None:
        """Do it all."""
        own = "{}.{}".format(*sys.version_info)
        what = "sdist, wheel and extension twice, in other surroundings; the wheel from the sdist; what they hold"
        self.line("build", own, Row(own).version, lambda: what, self.build)
        for row in rows:
            self.row(row)
        for row in rows:
            if REFERENCE in rows and row.blender and row != REFERENCE:
                pair = (f"{REFERENCE.python} and {row.python}", f"{REFERENCE.version} and {row.version}")
                for engine in chain.ENGINES:
                    compare = partial(self.pictures, REFERENCE, row, engine)
                    self.line(f"pictures by {engine}", *pair, lambda: "compared, pixel by pixel", compare)
        self.line("bills", own, "none", lambda: "validated by cyclonedx-python-lib", self.validate)

    def line(self, name: str, python: str, bpy: str, did: Callable[[], str], work: Callable[[], str]) -> None:
        """Do some work and put what came of it into the table."""
        print(f"{name}, Python {python}, bpy {bpy} ...", flush=True)
        begun = time.monotonic()
        try:
            result = f"{GOOD}{work()}"
        except places.AbsentError as error:
            result = f"not run: {error}"
        except (FailedError, chain.StepError) as error:
            result = f"FAILED: {error}"
        self.table.append((name, python, bpy, did(), f"{time.monotonic() - begun:.0f}", " ".join(result.split())))
        print(f"  {self.table[-1][-1]}", flush=True)

    def build(self) -> str:
        """Build all there is in two surroundings, and the wheel from the sdist; compare."""
        epoch = {"SOURCE_DATE_EPOCH": builds.committed(ROOT)}
        made = []
        try:
            for name, around in (("here", builds.HERE), ("there", builds.THERE)):
                folder = self._new(f"builds/{name}")
                tree = builds.copied(ROOT, folder / "tree", around)
                archives = builds.archives(tree, folder / "made", around, **epoch)
                made.append({**archives, "extension": builds.extension(tree, folder / "made", around)})
            tree = builds.unpacked(made[1]["sdist"], folder / "unpacked")
            again = builds.archives(tree, folder / "again", builds.HERE, "wheel", **epoch)
        except subprocess.CalledProcessError as error:
            raise FailedError(f"{' '.join(error.cmd[1:4])}: {error.stderr.strip()}") from None
        self.made = made[0]
        pairs = [(kind, path, made[1][kind]) for kind, path in self.made.items()]
        pairs.append(("wheel made from the sdist", self.made["wheel"], again["wheel"]))
        faults = [f"{kind} differs" for kind, one, other in pairs if builds.digest(one) != builds.digest(other)]
        faults += builds.faults(self.made, builds.tracked(ROOT))
        if faults:
            raise FailedError("; ".join(faults))
        bill = self.output / sbom.NAME
        bill.write_bytes(zipfile.ZipFile(self.made["extension"]).read(sbom.NAME))
        self.bills.append(bill)
        return ", the same bytes: " + ", ".join(f"{k} {builds.digest(p)[:12]}" for k, p in self.made.items())

    def row(self, row: Row) -> None:
        """Install the wheel and go the user's way."""
        pins = [pin for pin in pinned(row.python, row.bpy) if row.blender or not pin.startswith("bpy==")]
        bpy = row.version if row.blender else None
        log = self.output / f"{row.name}.log"
        log.unlink(missing_ok=True)
        did: list[str] = []

        def work() -> str:
            if "wheel" not in self.made:
                raise places.AbsentError("there is no wheel")
            if not row.blender and not self.rendered:
                raise places.AbsentError("no row has rendered anything to train on")
            folder = self._new(f"rows/{row.name}")
            named = self.arguments.python.get(row.python)
            with places.place(row.python, named, folder, self.arguments.root, log) as place:
                run, wheels = chain.Run(place, log, did), self._wheels(row.python, pins, log)
                try:
                    chain.install(run, self.made["wheel"], wheels, pins, bpy)
                    if row.blender:
                        chain.with_blender(run)
                    else:
                        chain.without_blender(run, {one.name: path for one, path in self.rendered.items()})
                finally:
                    for name in ("venv", "wheels"):
                        shutil.rmtree(run.path(name), ignore_errors=True)
                    if place.folder != folder:
                        shutil.copytree(place.folder, folder, dirs_exist_ok=True)
            self.bills.append(folder / chain.BILL)
            if row.blender:
                self.rendered[row] = folder
                return self._same_extension(folder)
            return ""

        self.line("install and use", row.python, row.version, lambda: ", ".join(did), work)

    def pictures(self, one: Row, other: Row, engine: str) -> str:
        """Compare what two rows have rendered."""
        if lacking := [row.name for row in (one, other) if row not in self.rendered]:
            raise places.AbsentError(f"{' and '.join(lacking)} rendered nothing")
        try:
            good, words = pictures.compared(self.rendered[one] / engine, self.rendered[other] / engine, engine)
        except NlosError as error:
            raise FailedError(str(error)) from None
        if not good:
            raise FailedError(words)
        return f": {words}"

    def validate(self) -> str:
        """Hold all bills of materials against the schema, by the library of those who made it."""
        tools, log = self._new("tools"), self.output / "tools.log"
        with _absent(log):
            _call([sys.executable, "-m", "venv", str(tools)], log)
            pip = [str(tools / "bin/python"), "-m", "pip", "install", "--quiet", "--only-binary=:all:"]
            _call([*pip, "-r", str(HERE / "tools.txt")], log)
        checked = subprocess.run(
            [str(tools / "bin/python"), "-c", VALIDATE, *map(str, self.bills)],
            capture_output=True,
            text=True,
            check=False,
        )
        if checked.returncode:
            raise FailedError(checked.stderr.strip())
        counts = [len(sbom.table(bill.read_text(encoding="utf-8")).splitlines()) for bill in self.bills]
        return f": {len(counts)} bills are CycloneDX 1.6, of {', '.join(map(str, counts))} parts"

    def _same_extension(self, folder: Path) -> str:
        """Compare the zip that a row has built from the installed wheel with that of the tree."""
        [mine] = (folder / "extension").glob("*.zip")
        if builds.digest(mine) == builds.digest(self.made["extension"]):
            return "; its extension is the same bytes"
        both = [zipfile.ZipFile(path).read(sbom.NAME) for path in (mine, self.made["extension"])]
        if both[0] != both[1]:
            raise FailedError("the extension built from the wheel is another than that of the tree")
        return "; its extension holds the same files, packed otherwise"

    def _wheels(self, python: str, pins: list[str], log: Path) -> Path:
        """Download what is pinned for a Python; what is there already is not downloaded again."""
        folder = self.output / f"wheels-{python}"
        folder.mkdir(exist_ok=True)
        flags = ["--no-deps", "--only-binary=:all:", "--python-version", python, "-d", str(folder)]
        with _absent(log):
            _call([sys.executable, "-m", "pip", "download", "--quiet", *flags, *pins], log)
        return folder

    def _new(self, name: str) -> Path:
        folder = self.output / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder


def pinned(python: str, bpy: str | None = None) -> Iterator[str]:
    """Yield what constraints.txt pins for a Python, with another bpy if one is named."""
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            pin = Requirement(line)
            if pin.marker is None or pin.marker.evaluate({"python_version": python}):
                yield f"bpy=={bpy}" if bpy and pin.name == "bpy" else f"{pin.name}{pin.specifier}"


def written(table: list[tuple[str, ...]], wide: int = 48) -> str:
    """Return a table as text; cells that are wider go on below."""
    rows = [[_wrapped(cell, wide) for cell in line] for line in (HEAD, *table)]
    widths = [max(len(part) for row in rows for part in row[column]) for column in range(len(HEAD))]
    lines = []
    for row in rows:
        for k in range(max(map(len, row))):
            parts = [cell[k] if k < len(cell) else "" for cell in row]
            lines.append(" | ".join(part.ljust(width) for part, width in zip(parts, widths, strict=True)).rstrip())
        lines.append("-+-".join("-" * width for width in widths))
    return "\n".join(lines) + "\n"


def _wrapped(text: str, wide: int) -> list[str]:
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > wide:
            lines.append("")
        lines[-1] += " " * bool(lines[-1]) + word
    return lines


@contextmanager
def _absent(log: Path) -> Iterator[None]:
    """Say that something could not be run where a package could not be had."""
    try:
        yield
    except subprocess.CalledProcessError as error:
        said = [line for line in error.output.splitlines() if line.startswith("ERROR: ")] or [f"see {log.name}"]
        raise places.AbsentError(f"{error.cmd[3]} failed: {said[-1].removeprefix('ERROR: ')}") from None


def _call(command: list[str], log: Path) -> None:
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    with open(log, "a", encoding="utf-8") as file:
        file.write(done.stdout)
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, command, output=done.stdout)


def _named(text: str) -> tuple[str, str]:
    version, _, path = text.partition("=")
    if not re.fullmatch(r"3\.\d+", version) or not path:
        raise argparse.ArgumentTypeError(f"{text!r} is not VERSION=PATH, such as 3.13=/path/to/python3.13")
    return version, path


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Build everything, and use it under every Python and Blender.")
    names = [row.name for row in ROWS]
    parser.add_argument("--rows", nargs="+", choices=names, default=names, help="default: all of them")
    parser.add_argument(
        "--python",
        type=_named,
        action="append",
        default=[],
        metavar="VERSION=PATH",
        help="a Python to use, e.g. 3.13=PATH; default: pythonVERSION, else that of a Debian below --root",
    )
    parser.add_argument(
        "--root",
        type=Path,
        default=Path(os.environ.get("NLOS_GUI_ROOT", "/opt/roots")),
        metavar="FOLDER",
        help="where Debian systems are or go, those of `make gui`; default: NLOS_GUI_ROOT or %(default)s",
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("dist/matrix"), help="folder for table and logs")
    arguments = parser.parse_args()
    arguments.python = dict(arguments.python)
    # Or what is mounted would stay so.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        arguments.output.mkdir(parents=True, exist_ok=True)
        builds.committed(ROOT)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    matrix = Matrix(arguments)
    try:
        matrix.run([row for row in ROWS if row.name in arguments.rows])
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    finally:
        text = written(matrix.table)
        (arguments.output / "matrix.txt").write_text(text, encoding="utf-8")
        print(f"\n{text}", end="")
    return int(not matrix.good)


if __name__ == "__main__":
    sys.exit(main())
