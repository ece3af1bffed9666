"""Compiled loops: not imported early, compiled once, cached if possible."""

import os
import pwd
import re
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import isac_track

PACKAGE = Path(isac_track.__file__).parent
USE = """
import numpy as np
from isac_track import kalman
batch = kalman.Batch(
    np.arange(3.0), np.ones((3, 2)), np.ones(3), np.array([0, 3]), prior_std=(1, 1)
)
last = kalman.kalman_last(batch, q=1.0)
print(last.mean[0, 0, 0])
"""
NOTICE = "isac-track: compiling filters, once, a few seconds\n"


def run(code, *, user=None, cwd=None, **environment):
    """Run Python code in a clean environment; warnings are errors."""
    variables = {key: os.environ[key] for key in ("PATH", "LANG") if key in os.environ}
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        user=user,
        env=variables | environment,
        timeout=120,
    )


def test_numba_is_not_imported_before_it_is_needed_and_prepare_brings_in_all_loops(
    tmp_path,
):
    code = (
        "import sys\nfrom isac_track import kalman\nearly = sys.modules.keys() &"
        " {'numba', 'filterpy', 'scipy'}\nimport isac_track.linkability\nearly |="
        " sys.modules.keys() & {'numba'}\nkalman.prepare()\nloops ="
        " {f'isac_track.kalman._{name}_loops' for name in ('linear', 'imm',"
        " 'error')}\nprint(early, loops <= sys.modules.keys())"
    )
    done = run(code, HOME=str(tmp_path))
    assert done.stdout == "set() True\n", done.stdout + done.stderr


@pytest.mark.slow
def test_first_use_compiles_for_seconds_and_says_so_and_later_use_is_silent(tmp_path):
    environment = {"NUMBA_CACHE_DIR": str(tmp_path), "HOME": str(tmp_path)}
    before = os.times()
    first = run(USE, **environment)
    after = os.times()  # processor time: other work is not the compiler's
    assert (first.returncode, first.stderr) == (0, NOTICE)
    assert sum(after[2:4]) - sum(before[2:4]) < 10.0
    second = run(USE, **environment)
    assert (second.returncode, second.stderr) == (0, "")
    assert second.stdout == first.stdout


@pytest.fixture
def read_only_copy():
    """A read-only copy of the package, outside root's private folders."""
    folder = Path(tempfile.mkdtemp(prefix="isac-track-read-only-"))
    copy = folder / "isac_track"
    ignored = shutil.ignore_patterns("__pycache__", "*.npz")
    shutil.copytree(PACKAGE, copy, ignore=ignored)
    folder.chmod(0o755)
    for path in copy.rglob("*"):
        path.chmod(0o555 if path.is_dir() else 0o444)
    copy.chmod(0o555)
    yield folder
    for path in [copy, *copy.rglob("*")]:
        path.chmod(path.stat().st_mode | stat.S_IWUSR)
    shutil.rmtree(folder)


def ordinary_user():
    """An account without privileges, or a skip: root may write to read-only folders."""
    if os.geteuid() != 0:
        return None
    try:
        user = pwd.getpwnam("nobody").pw_uid
    except KeyError:
        pytest.skip("runs as root, and there is no account `nobody` to become")
    if run("import numba", user=user, cwd="/").returncode != 0:
        pytest.skip("runs as root, and `nobody` may not read this Python installation")
    return user


@pytest.mark.slow
def test_a_read_only_installation_compiles_in_every_process_and_says_so(
    read_only_copy, tmp_path
):
    code = f"import sys; sys.path.insert(0, {str(read_only_copy)!r})\n" + USE
    code += "import isac_track; print(isac_track.__file__)"
    done = run(code, user=ordinary_user(), cwd="/", HOME="/nonexistent")
    assert done.returncode == 0, done.stderr
    estimate, origin = done.stdout.splitlines()
    assert estimate == run(USE, HOME=str(tmp_path)).stdout.strip()
    assert origin.startswith(str(read_only_copy))
    assert re.fullmatch(
        r"isac-track: compiling filters, .* on every start: no cache can be written"
        r" .*\n",
        done.stderr,
    )
    assert not list(read_only_copy.rglob("*.nbi"))
