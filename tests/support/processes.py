"""Sweeps in processes of their own, to be killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

from conftest import ROOT


def start(scene, path, *options):
    return subprocess.Popen(
        [sys.executable, "-m", "generator.cli", "sweep", str(scene), "-o", str(path), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        # A shell that runs the tests in the background has them, and all they start, ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_for_pictures(path, count, process, timeout=120):
    end = time.monotonic() + timeout
    while len(list(path.glob("?/*.exr"))) < count:
        assert time.monotonic() < end, "no pictures appear"
        assert process.poll() is None, "the sweep ended before it was killed"
        time.sleep(0.02)
