"""Debian systems in folders, each with a Blender or a Python newer than the machine's: made, entered and left."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

PACKAGES = (
    "blender",
    "imagemagick",
    "libgl1-mesa-dri",
    "python3-numpy",
    # Blender 5.2's extension manager imports these two; Debian's package does not ask for them.
    "python3-cattr",
    "python3-requests",
    "xdotool",
    "xvfb",
)


class MissingError(Exception):
    """The machine lacks something, and what would mend it."""


def check_machine(root: Path) -> None:
    """Refuse a machine that cannot enter ``root``, or cannot make it if it is not there yet.

    Raises
    ------
    MissingError
        Not root, or no debootstrap.
    """
    if os.geteuid() != 0:
        raise MissingError("this needs root, to mount and chroot; run it as root")
    if not root.exists() and not shutil.which("debootstrap"):
        raise MissingError("debootstrap is missing; install it with: apt-get install debootstrap")


def mirror() -> str:
    """Return the Debian mirror that this machine's own apt uses.

    Raises
    ------
    MissingError
        It uses none.
    """
    asked = ["apt-get", "indextargets", "--format", "$(ORIGIN)|$(LABEL)|$(REPO_URI)", "Created-By: Packages"]
    try:
        found = subprocess.run(asked, capture_output=True, text=True, check=False).stdout
    except FileNotFoundError:
        found = ""
    for line in found.splitlines():
        origin, label, address = line.split("|")
        if (origin, label) == ("Debian", "Debian"):
            return address
    raise MissingError("apt knows no Debian mirror (after apt-get update); name one: --mirror ADDRESS")


@contextmanager
def locked(root: Path) -> Iterator[None]:
    """Keep other runs out of a root."""
    root.parent.mkdir(parents=True, exist_ok=True)
    with open(root.parent / f".{root.name}.lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"waiting for another run to leave {root}", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def make(root: Path, suite: str, address: str, log: Path) -> None:
    """Make a minimal Debian.

    Raises
    ------
    MissingError
        debootstrap failed.
    """
    print(f"making {root} (Debian {suite}; with Blender about 2 GB and two minutes)", flush=True)
    root.parent.mkdir(parents=True, exist_ok=True)
    # Renamed when it is whole, so that a root which is there can be trusted.
    begun = Path(tempfile.mkdtemp(prefix=f"{root.name}.begun-", dir=root.parent))
    begun.chmod(0o755)
    try:
        _run(["debootstrap", "--variant=minbase", suite, str(begun), address], log)
    except MissingError as error:
        raise MissingError(f"{error}; delete what it left in {begun}") from None
    # Nothing here has to outlive a power cut, and no service is to start in a chroot.
    (begun / "etc/dpkg/dpkg.cfg.d/unsafe-io").write_text("force-unsafe-io\n")
    policy = begun / "usr/sbin/policy-rc.d"
    policy.write_text("#!/bin/sh\nexit 101\n")
    policy.chmod(0o755)
    begun.rename(root)


def complete(root: Path, log: Path, packages: Sequence[str] = PACKAGES) -> None:
    """Install those packages that are not installed yet; the root must be mounted.

    Raises
    ------
    MissingError
        apt failed.
    """
    query = enter(root, ["dpkg-query", "--show", "--showformat", "${Package} ${db:Status-Status}\n"])
    told = subprocess.run(query, capture_output=True, text=True, check=True, env=environment()).stdout
    missing = [name for name in packages if f"{name} installed" not in told.splitlines()]
    if missing:
        print(f"installing into {root}: {' '.join(missing)}", flush=True)
        shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
        # A mirror that is a snapshot keeps a Release file past its date; its signature is checked all the same.
        _run(enter(root, ["apt-get", "-o", "Acquire::Check-Valid-Until=false", "update"]), log)
        _run(enter(root, ["apt-get", "install", "-y", "--no-install-recommends", *missing]), log)
        _run(enter(root, ["apt-get", "clean"]), log)


@contextmanager
def mounted(root: Path) -> Iterator[None]:
    """Give a root the kernel's file systems that it does not have yet, and take those away again."""
    with ExitStack() as stack:

        def mount(where: Path, *arguments: str) -> bool:
            if os.path.ismount(where):
                return False
            subprocess.run(["mount", *arguments, str(where)], check=True)
            stack.callback(_unmount, where)
            return True

        mount(root / "proc", "-t", "proc", "proc")
        if mount(root / "dev", "--bind", "/dev"):
            # Or what is mounted on dev/shm would cover the machine's own.
            subprocess.run(["mount", "--make-private", str(root / "dev")], check=True)
            mount(root / "dev/shm", "-t", "tmpfs", "tmpfs")
        yield


def enter(root: Path, command: Sequence[str]) -> list[str]:
    """Return the command that runs a command inside a root."""
    return ["chroot", str(root), *command]


def environment(**more: str) -> dict[str, str]:
    """Return the environment for commands inside: none of the machine's own but its way to the mirror."""
    kept = {name: value for name, value in os.environ.items() if name.lower().endswith("_proxy")}
    path = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
    return {**kept, "PATH": path, "LANG": "C.UTF-8", "DEBIAN_FRONTEND": "noninteractive", **more}


def processes(root: Path) -> dict[int, str]:
    """Return the processes that run inside a root: process id and command line."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.readlink(folder / "root") == str(root):
                words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                if words:  # else a zombie, which is waited for elsewhere
                    found[int(folder.name)] = words
        except OSError:  # it has ended meanwhile
            continue
    return found


def _run(command: Sequence[str], log: Path) -> None:
    with open(log, "ab") as file:
        done = subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=False, env=environment())
    if done.returncode:
        raise MissingError(f"{' '.join(command)} failed, see {log}")


def _unmount(where: Path) -> None:
    for _ in range(50):  # what was just killed may hold it for a moment
        done = subprocess.run(["umount", str(where)], capture_output=True, text=True, check=False)
        if not done.returncode:
            return
        time.sleep(0.1)
    print(f"error: {where} stays mounted: {done.stderr.strip()}", flush=True)
