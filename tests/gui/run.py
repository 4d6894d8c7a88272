"""The extension in real windows of Blender, on a screen that exists in memory only: ``python tests/gui/run.py``.

Debian packages the Blenders, so each runs in a Debian of its own below ``--root``, made on the first run. Inside,
`drive.py` runs the steps of ``steps_*.py`` one after the other. It asks for what a program cannot do for itself by
files in the folder ``shots``: a picture of the screen, and keys and mouse.

Ends with 1 if a step failed, Blender crashed or hung, its output tells of an error or something was left running, and
with 2 if the machine lacks something. Logs and pictures go to ``--output``.
"""

from __future__ import annotations

import argparse
import os
import queue
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import roots

HERE = Path(__file__).resolve().parent
SUITES = {"4.3": "trixie", "5.2": "sid"}
SIZE = (1400, 900)
MARK = "@@ "  # what `helpers.say` puts before its lines
# What Blender prints of errors in Python, and of panels that ask for what is not there.
ERRORS = ("Traceback (most recent call last)", "property not found", "unknown operator")


@dataclass
class Outcome:
    """What one Blender came to."""

    version: str
    passed: int = 0
    failed: int = 0
    seconds: float = 0.0
    step: str = "start"
    ended: bool = False
    log: list[str] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)

    def note(self, words: str) -> None:
        """Write into the log when something was said."""
        self.log.append(f"{time.monotonic() - self.began:7.2f}  {words}")

    def fail(self, words: str) -> None:
        """Count a failure that the steps themselves do not know of."""
        self.failed += 1
        self.note(f"FAILED {words}")
        print(f"FAILED {words}", flush=True)


class Session:
    """One Blender on one screen: what it says is read, what it asks for is done."""

    def __init__(self, root: Path, outcome: Outcome) -> None:
        self.root, self.outcome = root, outcome
        self.shots = root / "gui" / "shots"
        self.environment = roots.environment(LIBGL_ALWAYS_SOFTWARE="1")
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._quoted, self._quoting = "", False

    @contextmanager
    def screen(self) -> Iterator[None]:
        """Start the X server, which finds a free display by itself."""
        ours, theirs = os.pipe()
        size = f"{SIZE[0]}x{SIZE[1]}x24"
        command = ["Xvfb", "-displayfd", str(theirs), "-screen", "0", size, "-noreset", "-nolisten", "tcp"]
        with _started(self.root, command, self.environment, pass_fds=(theirs,)):
            os.close(theirs)
            with open(ours) as told:
                number = told.readline().strip()
            if not number:
                raise roots.MissingError(f"Xvfb does not start in {self.root}")
            self.environment["DISPLAY"] = f":{number}"
            yield

    def blender(self, limit: float) -> None:
        """Run the steps."""
        command = ["blender", "--factory-startup", "--offline-mode", "-noaudio", "--gpu-backend", "opengl"]
        command += ["-p", "0", "0", *map(str, SIZE), "--python", "/gui/drive.py"]
        with _started(self.root, command, self.environment, stdout=subprocess.PIPE) as process:
            assert process.stdout
            threading.Thread(target=self._read, args=(process.stdout,), daemon=True).start()
            deadline = time.monotonic() + limit
            while process.poll() is None and time.monotonic() < deadline:
                self._serve()
                self._tell(0.02)
            if process.poll() is None:
                os.kill(process.pid, signal.SIGUSR1)  # makes it say where in Python it hangs
                self._tell(2.0)
                self.outcome.fail(f"step {self.outcome.step}: not done when the {limit:g} s were over")
            else:
                self._tell(1.0)
                self._judge(process.returncode)

    def _judge(self, code: int) -> None:
        if code < 0:
            self.outcome.fail(f"step {self.outcome.step}: Blender crashed ({signal.Signals(-code).name})")
        elif not self.outcome.ended:
            self.outcome.fail(f"step {self.outcome.step}: Blender ended by itself (exit code {code})")

    def _read(self, stream: IO[bytes]) -> None:
        for line in stream:
            self._lines.put(line.decode(errors="replace").rstrip())
        self._lines.put(None)

    def _tell(self, seconds: float) -> None:
        """Pass on what Blender says until it says nothing for a while, or very much."""
        try:
            for _ in range(1000):
                line = self._lines.get(timeout=seconds)
                if line is None:
                    return
                self._take(line)
        except queue.Empty:
            pass

    def _take(self, line: str) -> None:
        said, outcome = line.removeprefix(MARK), self.outcome
        outcome.note(said)
        if said != line:
            kind, _, rest = said.partition(" ")
            if kind == "begin":
                outcome.step = rest
            elif kind == "end":
                outcome.ended = True
            else:
                print(said, flush=True)
                if rest.startswith(f"{outcome.step} ("):
                    outcome.passed += kind == "ok"
                    outcome.failed += kind == "FAILED"
        elif any(words in line for words in ERRORS) and self._quoted != outcome.step:
            # Once a step, for a panel repeats its error at every redraw.
            self._quoted, self._quoting = outcome.step, "Traceback" in line
            outcome.fail(f"step {outcome.step}: an error in Blender's output")
            print(line, flush=True)
        elif self._quoting:
            print(line, flush=True)
            self._quoting = line.startswith(" ")

    def _serve(self) -> None:
        for request in self.shots.glob("*.request"):
            made = request.with_suffix(".tmp")
            told = self._inside("import", "-window", "root", f"png:/gui/shots/{made.name}")
            request.unlink()
            if told:
                self.outcome.fail(f"step {self.outcome.step}: no picture {request.stem}: {told}")
                made.touch()
            made.rename(request.with_suffix(".png"))
        for request in self.shots.glob("*.xdotool"):
            told = self._inside("xdotool", *shlex.split(request.read_text(encoding="utf-8")))
            request.unlink()
            made = request.with_suffix(".tmp")
            made.write_text(told, encoding="utf-8")
            made.rename(request.with_suffix(".done"))

    def _inside(self, *command: str) -> str:
        """Run a command inside; return what went wrong, or nothing."""
        try:
            done = subprocess.run(
                roots.enter(self.root, command),
                capture_output=True,
                text=True,
                check=False,
                env=self.environment,
                timeout=30,
            )
        except subprocess.TimeoutExpired:
            return f"{command[0]} took longer than 30 s"
        return (done.stderr.strip() or f"{command[0]} ended with {done.returncode}") if done.returncode else ""


@contextmanager
def _started(
    root: Path, command: list[str], environment: dict[str, str], **pipes: object
) -> Iterator[subprocess.Popen]:
    """Run a command inside as long as the context lasts; then end it and all its children."""
    process = subprocess.Popen(
        roots.enter(root, command),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.STDOUT,
        env=environment,
        start_new_session=True,
        **{"stdout": subprocess.DEVNULL, **pipes},
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def build(folder: Path) -> Path:
    """Build the extension.

    Raises
    ------
    MissingError
        This Python lacks the project or the bpy wheel, or the extension cannot be built.
    """
    try:
        from blender_addon.packaging import build as extension
    except ImportError as error:
        raise roots.MissingError(f"{error}; run `make setup` and use .venv/bin/python") from None
    try:
        return extension.build(folder)
    except extension.BuildError as error:
        raise roots.MissingError(str(error)) from None


def drive(root: Path, package: Path, outcome: Outcome, limit: float) -> None:
    """Run one Blender in a root that is mounted."""
    folder = root / "gui"
    if folder.exists():
        shutil.rmtree(folder)
    (folder / "shots").mkdir(parents=True)
    inside = [path for path in HERE.glob("*.py") if path.name not in ("run.py", "roots.py")]
    for path in (package, *inside):
        shutil.copy(path, folder)
    before = roots.processes(root)
    session = Session(root, outcome)
    with ExitStack() as stack:
        own = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="nlos-gui-", dir=root / "tmp")))
        inside = f"/tmp/{own.name}"
        for name in ("home", "user", "tmp", "work"):
            (own / name).mkdir()
        session.environment |= {
            "HOME": f"{inside}/home",
            "BLENDER_USER_RESOURCES": f"{inside}/user",
            "TMPDIR": f"{inside}/tmp",
            "NLOS_GUI_WORK": f"{inside}/work",
        }
        try:
            with session.screen():
                session.blender(limit)
        finally:
            left = {pid: words for pid, words in roots.processes(root).items() if pid not in before}
            for pid in left:
                os.kill(pid, signal.SIGKILL)
        for words in left.values():
            outcome.fail(f"left running: {words}")
        for crash in (own / "tmp").glob("*.crash.txt"):
            outcome.log += ["", crash.name, *crash.read_text(errors="replace").splitlines()]


def run(version: str, arguments: argparse.Namespace, package: Path) -> Outcome:
    """Make what is missing, run one Blender, and keep its log and pictures."""
    root, output = (arguments.root / SUITES[version]).resolve(), arguments.output
    outcome = Outcome(version)
    for old in output.glob(f"gui-{version}-*.png"):
        old.unlink()
    with ExitStack() as stack:
        stack.enter_context(roots.locked(root))
        made = output / f"root-{SUITES[version]}.log"
        if not root.exists():
            roots.make(root, SUITES[version], arguments.mirror or roots.mirror(), made)
        stack.enter_context(roots.mounted(root))
        roots.complete(root, made)
        told = subprocess.run(
            roots.enter(root, ["blender", "--version"]),
            capture_output=True,
            text=True,
            check=False,
            env=roots.environment(HOME="/tmp"),
        )
        outcome.version = (told.stdout.splitlines() or [f"Blender {version}"])[0].removeprefix("Blender ")
        print(f"\nBlender {outcome.version}", flush=True)
        if not outcome.version.startswith(version + "."):
            print(f"note: Debian {SUITES[version]} has no Blender {version} any more")
        outcome.began = time.monotonic()
        try:
            drive(root, package, outcome, arguments.limit)
        finally:
            outcome.seconds = time.monotonic() - outcome.began
            (output / f"gui-{version}.log").write_text("\n".join(outcome.log) + "\n", encoding="utf-8")
            for picture in (root / "gui" / "shots").glob("*.png"):
                shutil.copy(picture, output / f"gui-{version}-{picture.name}")
    return outcome


def summarise(outcomes: list[Outcome]) -> None:
    """Say how each Blender did, also where the next one could not be started."""
    print()
    for one in outcomes:
        print(f"Blender {one.version}: {one.passed} passed, {one.failed} failed in {one.seconds:.0f} s", flush=True)


def main() -> int:
    """Run from the command line."""
    outcomes: list[Outcome] = []
    parser = argparse.ArgumentParser(description="Test the extension in real windows of Blender.")
    parser.add_argument(
        "--root",
        type=Path,
        default=Path(os.environ.get("NLOS_GUI_ROOT", "/opt/roots")),
        metavar="FOLDER",
        help="where the Debian systems are or go, 2 GB each; default: NLOS_GUI_ROOT or %(default)s",
    )
    parser.add_argument("--blender", nargs="+", choices=SUITES, default=list(SUITES), help="default: all of them")
    parser.add_argument("--mirror", metavar="ADDRESS", help="Debian mirror; default: that of this machine's apt")
    parser.add_argument("--limit", type=float, default=1800.0, metavar="S", help="seconds for each Blender")
    parser.add_argument("-o", "--output", type=Path, default=Path("dist/gui"), help="folder for logs and pictures")
    arguments = parser.parse_args()
    # Or what is mounted would stay so.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        for version in arguments.blender:
            roots.check_machine(arguments.root / SUITES[version])
        arguments.output.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="nlos-gui-") as folder:
            package = build(Path(folder))
            for version in arguments.blender:
                outcomes.append(run(version, arguments, package))
    except roots.MissingError as error:
        summarise(outcomes)
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    summarise(outcomes)
    return int(any(one.failed or not one.ended for one in outcomes))


if __name__ == "__main__":
    sys.exit(main())
