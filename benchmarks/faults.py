"""Inject faults into sweeps: is nothing lost, and are the pixels those of an undisturbed run?

Run: ``python benchmarks/faults.py -o DIR [--kills 200]``, as root for full and read-only disks (a small tmpfs is
mounted for these). The clock is set back by libfaketime, and the network's file system is `slowfs`, mounted
twice: ``apt-get install faketime fuse3 python3-pyfuse3``. Prints and writes a table, a row per fault, and exits
with 1 if a picture is lost or differs.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import results

from generator.sets.dataset import Dataset

RESULTS = {
    "faults": ("fault", "how", "times", "pictures lost", "pixels different", "files left over", "what happened")
}
SWEEP = ("--poses", "20", "--resolution", "16", "--engine", "patch", "--samples", "64", "--workers", "2")
"""Options of a sweep that takes some minutes, in small pieces."""


def command(*arguments: object) -> list[str]:
    """Return a command line of the generator."""
    return [sys.executable, "-m", "generator.cli", *map(str, arguments)]


def finished(scene: Path, path: Path) -> subprocess.CompletedProcess[str]:
    """Run the sweep to its end, as its user would after a fault."""
    return subprocess.run(command("sweep", scene, "-o", path, *SWEEP), capture_output=True, text=True, check=False)


def children(pid: int) -> list[int]:
    """Return the processes that any thread of a process has started."""
    pids = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            pids += [int(n) for n in task.read_text().split()]
    return pids


def pictures(path: Path) -> int:
    """Return how many pictures are on disk."""
    return len(list(path.glob("?/[0-9]*.exr")))


def killed(scene: Path, path: Path, rng: np.random.Generator, kills: int, whom: str) -> tuple[int, str]:
    """Kill workers, the coordinator or either at random times, ``kills`` times; return how many, and words."""
    count = 0
    process: subprocess.Popen[str] | None = None
    runs = 0
    while count < kills:
        if process is None or process.poll() is not None:
            if pictures(path) >= 180 and process is not None:  # all are rendered: remove some, and continue
                files = sorted(path.glob("?/[0-9]*.exr"))
                for k in rng.choice(len(files), 120, replace=False):
                    files[k].unlink()
            process = subprocess.Popen(
                command("sweep", scene, "-o", path, *SWEEP),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            runs += 1
        time.sleep(rng.uniform(0.05, 2.0))
        workers = children(process.pid)
        victim = process.pid if whom == "coordinator" or (whom == "either" and rng.random() < 0.2) else 0
        if not victim and workers:
            victim = workers[rng.integers(len(workers))]
        if victim and (path / "dataset.toml").exists():
            with contextlib.suppress(ProcessLookupError):
                os.kill(victim, signal.SIGKILL)
                count += 1
    assert process is not None
    process.kill()
    process.wait()
    time.sleep(1.0)  # until the workers notice that the coordinator is gone
    return count, f"{runs} runs"


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[None]:
    """Mount a small file system on a folder."""
    folder.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def full_disk(scene: Path, path: Path) -> tuple[int, str]:
    """Let the disk run full, check the message, and give it room again."""
    result = finished(scene, path)
    assert result.returncode == 2, (result.returncode, result.stderr)
    message = result.stderr.strip().splitlines()[-1]
    assert "No space left" in message, message
    subprocess.run(["mount", "-o", "remount,size=64m", str(path.parent)], check=True)
    return 1, message


def read_only(scene: Path, path: Path) -> tuple[int, str]:
    """Make the disk read-only in the middle of the sweep."""
    process = subprocess.Popen(
        command("sweep", scene, "-o", path, *SWEEP), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    while pictures(path) < 20:
        time.sleep(0.2)
    remount = ["mount", "-o", "remount,ro", str(path.parent)]
    while subprocess.run(remount, check=False, capture_output=True).returncode:  # while a picture is being written
        time.sleep(0.01)
    _, errors = process.communicate(timeout=600)
    subprocess.run(["mount", "-o", "remount,rw", str(path.parent)], check=True)
    assert process.returncode == 2, (process.returncode, errors)
    return 1, errors.strip().splitlines()[-1]


def hung(scene: Path, path: Path) -> tuple[int, str]:
    """Stop the workers in the middle of the sweep; the coordinator's patience is set to seconds for this."""
    script = (
        "import sys; from generator.jobs import workers; from generator.cli.main import main;"
        "workers._PATIENCE = (60.0, 5.0); workers._SLOWER = 1.0;"
        "workers.WorkerPool.__init__.__kwdefaults__['patience'] = workers._PATIENCE; sys.exit(main(sys.argv[1:]))"
    )
    line = [sys.executable, "-c", script, "sweep", str(scene), "-o", str(path), *SWEEP]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while pictures(path) < 20:
        time.sleep(0.2)
    for worker in children(process.pid):
        os.kill(worker, signal.SIGSTOP)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    log = (path / "log.txt").read_text()
    return log.count("said nothing"), "the run went on by itself"


def out_of_memory(scene: Path, path: Path) -> tuple[int, str]:
    """Give every process too little memory."""
    line = " ".join(command("sweep", scene, "-o", path, *SWEEP))
    result = subprocess.run(["bash", "-c", f"ulimit -v 1200000; {line}"], capture_output=True, text=True, check=False)
    assert result.returncode in (1, 2), result.returncode
    return 1, result.stderr.strip().splitlines()[-1]


def together(scene: Path, path: Path) -> tuple[int, str]:
    """Start two sweeps on one folder at once."""
    both = [
        subprocess.Popen(
            command("sweep", scene, "-o", path, *SWEEP), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    ends = [process.communicate(timeout=900) for process in both]
    codes = [process.returncode for process in both]
    refused = [errors.strip().splitlines()[-1] for _, errors in ends if errors.strip()]
    return 1, f"exit codes {codes}" + (f"; {refused[0]}" if refused else "")


def lost_manifest(scene: Path, path: Path) -> tuple[int, str]:
    """Imitate a power cut between a picture's rename and the manifest: the manifest is older than the pictures."""
    process = subprocess.Popen(
        command("sweep", scene, "-o", path, *SWEEP), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while not (path / "poses.csv").exists():
        time.sleep(0.1)
    old = (path / "poses.csv").read_bytes()
    while pictures(path) < 40:
        time.sleep(0.2)
    process.kill()
    process.wait()
    time.sleep(1.0)
    (path / "poses.csv").write_bytes(old)
    torn = sorted(path.glob("?/[0-9]*.exr"))[:5]
    for file in torn:  # some pictures reached the disk only in part
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    return 1, f"{len(torn)} pictures torn"


def clock(scene: Path, path: Path) -> tuple[int, str]:
    """Set the clock back by days while pictures are rendered, and by a year before a second run continues."""
    libraries = sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))
    assert libraries, "apt-get install faketime"
    stamp = path.parent / "clock"
    stamp.write_text("+0d\n")
    fake = {"LD_PRELOAD": str(libraries[0]), "FAKETIME_TIMESTAMP_FILE": str(stamp), "FAKETIME_CACHE_DURATION": "1"}
    environment = {**os.environ, **fake, "FAKETIME_DONT_FAKE_MONOTONIC": "1", "NO_FAKE_STAT": "1"}
    for back, until in (("-3d", 90), ("-365d", 140)):
        process = subprocess.Popen(
            command("sweep", scene, "-o", path, *SWEEP),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        while pictures(path) < until - 40:
            time.sleep(0.1)
        stamp.write_text(f"{back}\n")
        time.sleep(2.0)  # until libfaketime has read it
        os.kill(children(process.pid)[0], signal.SIGKILL)  # the log records this with the time of day
        while pictures(path) < until:
            time.sleep(0.1)
        process.terminate()
        process.wait()
    days = [line[:10] for line in (path / "log.txt").read_text().splitlines()]
    jumps = sum(later < earlier for earlier, later in itertools.pairwise(days))
    assert jumps >= 2, days
    return 2, f"the log goes back in time {jumps} times, to {min(days)}"


@contextlib.contextmanager
def network(backing: Path, *mounts: Path) -> Iterator[None]:
    """Mount a folder by `slowfs`, once for each machine that shares it."""
    servers = []
    script = Path(__file__).with_name("slowfs.py")
    try:
        for mount in mounts:
            mount.mkdir()
            servers.append(subprocess.Popen(["/usr/bin/python3", str(script), str(backing), str(mount)]))
            while not mount.is_mount():
                assert servers[-1].poll() is None, "apt-get install fuse3 python3-pyfuse3"
                time.sleep(0.1)
        yield
    finally:
        for mount, server in zip(mounts, servers, strict=False):
            subprocess.run(["umount", "-l", str(mount)], check=False)
            server.wait(10)


def shared(scene: Path, path: Path) -> tuple[int, str]:
    """Render two shares on two machines that share a slow file system with stale caches; kill one of them once."""
    backing, *mounts = (path.parent / name for name in ("backing", "here", "there"))
    backing.mkdir()
    with network(backing, *mounts):

        def share(k: int) -> subprocess.Popen[bytes]:
            line = command("sweep", scene, "-o", mounts[k] / "set", *SWEEP[:-1], "1", "--shard", f"{k}/2")
            return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

        runs = [share(0)]
        while not (mounts[1] / "set" / "background.exr").exists():
            assert runs[0].poll() is None, runs[0].communicate()
            time.sleep(0.2)
        runs.append(share(1))
        while pictures(backing / "set") < 60:
            time.sleep(0.2)
        runs[1].kill()
        runs[1].communicate()
        time.sleep(1.0)
        runs[1] = share(1)
        ends = [(run.communicate(timeout=900)[1].decode(), run.returncode) for run in runs]
        count = pictures(backing / "set")
    assert not any(code for _, code in ends), ends
    assert count == 180, (count, ends)
    backing.joinpath("set").rename(path)
    return 1, "two shares, one killed, by two mounts; nothing was left for a third run"


def main() -> int:
    """Inject every fault, finish each sweep, and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--only", nargs="*")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    scene = options.output / "scene.blend"
    subprocess.run(command("scene", "room", "--target", "sphere", "-o", scene), check=True, stdout=subprocess.DEVNULL)
    reference = options.output / "reference"
    if not Dataset.exists(reference):
        result = finished(scene, reference)
        assert result.returncode == 0, result.stderr
    expected = [pose.pixel_hash for pose in Dataset.open(reference).poses]
    rng = np.random.default_rng(0)
    disk = options.output / "disk"
    faults: dict[str, tuple[str, Callable[[Path], tuple[int, str]], str]] = {
        "killed": (
            "SIGKILL to workers and coordinator at random instants",
            lambda p: killed(scene, p, rng, options.kills, "either"),
            "",
        ),
        "hung": ("SIGSTOP to both workers", lambda p: hung(scene, p), ""),
        "memory": ("1.2 GB of address space", lambda p: out_of_memory(scene, p), ""),
        "full": ("tmpfs of 700 kB", lambda p: full_disk(scene, p), "700k"),
        "read-only": ("tmpfs remounted read-only", lambda p: read_only(scene, p), "64m"),
        "power": ("manifest of before, pictures cut in half", lambda p: lost_manifest(scene, p), ""),
        "clock": ("set back by 3 days while it runs, and by a year before it goes on", lambda p: clock(scene, p), ""),
        "network": ("renames 0.15 s late, attributes 3 s old, two machines", lambda p: shared(scene, p), ""),
        "two at once": ("the same command twice", lambda p: together(scene, p), ""),
    }
    table, bad = [], 0
    for name, (how, inject, size) in faults.items():
        if options.only and name not in options.only:
            continue
        folder = disk if size else options.output / name.replace(" ", "-")
        with small_disk(folder, size) if size else contextlib.nullcontext():
            path = folder / "set"
            if not size:
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
            times, words = inject(path)
            result = finished(scene, path)
            assert result.returncode == 0, (name, result.stderr)
            dataset = Dataset.open(path)
            lost = len(dataset.verify())
            differ = sum(a != pose.pixel_hash for a, pose in zip(expected, dataset.poses, strict=True))
            leftovers = len(list(path.rglob("*.tmp")))
        bad += lost + differ
        table.append((name, how, str(times), str(lost), str(differ), str(leftovers), words))
        print(" | ".join(table[-1]), flush=True)
        results.write(options.output, "faults", RESULTS["faults"], table)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
