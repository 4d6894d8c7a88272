"""The environment that the extension makes, with a shell script in place of Python and pip."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from blender_addon.session import making
from generator.model.errors import NlosError

PYTHON = """#!/bin/sh
case "$*" in
  *find_spec*) echo "{probed}";;
  *"-m venv"*) mkdir -p "$4/bin" "$4/site"; cp "$0" "$4/bin/python";;
  *sysconfig*) echo "$(dirname "$0")/../site";;
  *"-m pip"*) {pip};;
  *"import classify"*) {tried};;
esac
"""
OFFLINE = """\
WARNING: Retrying (Retry(total=0)) after connection broken by 'NewConnectionError('<urllib3.connection.HTTPS \
object at 0x7f>: Failed to establish a new connection: [Errno -2] Name or service not known')': /simple/numpy/
ERROR: Could not find a version that satisfies the requirement numpy==9 (from versions: none)
ERROR: No matching distribution found for numpy==9
"""
TIMED_OUT = """\
WARNING: Retrying (Retry(total=1)) after connection broken by "ReadTimeoutError("HTTPSConnectionPool(host='h', \
port=443): Read timed out. (read timeout=15)")": /simple/numpy/
ERROR: No matching distribution found for numpy==9
"""


def python(folder: Path, pip: str = "true", tried: str = "true", probed: str = "3.11 whole") -> str:
    path = folder / "python"
    path.write_text(PYTHON.format(pip=pip, tried=tried, probed=probed))
    path.chmod(0o755)
    return str(path)


def made(folder: Path, python: str, told: list[tuple[str, float]] | None = None) -> Path:
    return making.make(
        folder, lambda *progress: None if told is None else told.append(progress), threading.Event(), python
    )


def test_it_is_made_told_and_renewed(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "environment"
    pip = "echo Collecting numba==0.6; echo '  Downloading numba.whl'; echo Installing collected packages: a, b"
    told: list[tuple[str, float]] = []
    assert made(folder, python(tmp_path, pip), told) == folder / "bin/python"
    assert making.is_whole(folder)
    assert making.is_current(folder)
    assert (folder / "site/nlos_lab.pth").read_text().strip() == str(making.ADDON)
    assert not (folder / "temporary").exists()
    words, shares = [words for words, _ in told], [share for _, share in told]
    assert [word.partition(" ")[0] for word in words] == ["Preparing", "Downloading", "Unpacking", "Trying"]
    assert "numba, package 1 of" in words[1]
    assert shares == sorted(shares)
    assert shares[-1] < 1.0
    (folder / making.REQUIREMENTS).write_text("numpy==1.0\n")
    assert not making.is_current(folder)
    with pytest.raises(NlosError, match="no space"):
        made(folder, python(tmp_path, "echo ERROR: no space; exit 1"))
    assert making.is_whole(folder), "the older one stays"
    assert [path.name for path in folder.parent.iterdir()] == ["environment"]
    made(folder, python(tmp_path, pip))
    assert making.is_current(folder)
    making.remove(folder)
    making.remove(folder)
    assert not folder.exists()


@pytest.mark.parametrize(
    ("pip", "words"),
    [
        ("echo ERROR: No matching distribution found for numba==0.6; exit 1", "There is no numba==0.6 for Python 3."),
        (f"cat <<'E'\n{OFFLINE}E\nexit 1", r"cannot be reached \(Name or service not known\)"),
        (f"cat <<'E'\n{TIMED_OUT}E\nexit 1", r"cannot be reached \(Read timed out. \(read timeout=15\)\)"),
        ("echo ERROR: no space; echo; exit 1", "no space"),
        ("exit 7", "exit code 7"),
    ],
)
def test_a_failure_of_pip_is_a_sentence_and_leaves_nothing(tmp_path: Path, pip: str, words: str) -> None:
    with pytest.raises(NlosError, match=words):
        made(tmp_path / "environment", python(tmp_path, pip))
    assert not (tmp_path / "environment").exists()


def test_what_cannot_be_used_is_not_kept(tmp_path: Path) -> None:
    with pytest.raises(NlosError, match="No module named skops"):
        made(tmp_path / "environment", python(tmp_path, tried="echo No module named skops; exit 1"))
    with pytest.raises(NlosError, match=r"apt-get install python3\.13-venv"):
        made(tmp_path / "environment", python(tmp_path, probed="3.13"))
    with pytest.raises(NlosError, match="cannot be run"):
        made(tmp_path / "environment", str(tmp_path / "nowhere"))
    (tmp_path / "file").write_text("")
    with pytest.raises(NlosError, match="no environment can be made there"):
        made(tmp_path / "file" / "environment", python(tmp_path))
    assert not (tmp_path / "environment").exists()


def test_there_must_be_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "DISK_MB", 10**9)
    with pytest.raises(NlosError, match="MB free, but"):
        made(tmp_path / "environment", python(tmp_path))


def test_it_can_be_cancelled(tmp_path: Path) -> None:
    stop, began = threading.Event(), time.monotonic()
    threading.Timer(0.3, stop.set).start()
    with pytest.raises(NlosError, match="Cancelled"):
        making.make(tmp_path / "environment", lambda *told: None, stop, python(tmp_path, "exec sleep 60"))
    assert time.monotonic() - began < 10.0
    assert [path.name for path in tmp_path.iterdir()] == ["python"]
