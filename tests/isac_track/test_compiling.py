"""Compiled loops and their cache, each case in a cache folder of its own and a fresh process."""

import shutil
from itertools import product

import pytest
from helpers.commands import run

LOOP = """\
from isac_track.compiling import compiled, read, written

@compiled(read(1), written(1))
def double(values, out):
    for place in range(values.size):
        out[place] = 2.0 * values[place]
"""
CALL = """\
import numpy as np, small_loop
out = np.zeros(3)
small_loop.double(np.arange(3.0), out)
print(out.tolist())
"""
RIGHT = "[0.0, 2.0, 4.0]\n"


def flipped(content):
    """A byte in fifty is another: what is left may still be read, and compute something else."""
    return bytes(byte ^ 0xA5 if place % 50 == 7 else byte for place, byte in enumerate(content))


DAMAGES = {
    "empty": lambda _: b"",
    "cut short": lambda content: content[: len(content) // 2],
    "zeros in the middle": lambda content: (
        content[: len(content) // 3] + bytes(len(content) // 3) + content[2 * len(content) // 3 :]
    ),
    "flipped bytes": flipped,
}


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loops")
    (folder / "small_loop.py").write_text(LOOP)
    assert called(folder).err.count("compiling filters, once") == 1
    assert called(folder) == (0, RIGHT, "")  # from the cache, and nothing is said
    shutil.copytree(folder / "cache", folder / "whole")
    return folder


@pytest.fixture
def filled(compiled_once):
    """A folder whose cache is whole: it is called by the path of the source, and stays there."""
    shutil.rmtree(compiled_once / "cache")
    shutil.copytree(compiled_once / "whole", compiled_once / "cache")
    return compiled_once


def called(folder):
    changed = {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    code = f"import sys; sys.path.insert(0, {str(folder)!r})\n{CALL}"
    return run(folder, "-c", code, changed=changed)


def cached(folder, kind):
    (path,) = (folder / "cache").rglob(f"*{kind}")
    return path


CASES = [*product(DAMAGES, (".nbi", ".nbc")), ("empty", ".sha256")]


@pytest.mark.parametrize(("damage", "kind"), CASES)
def test_a_damaged_cache_is_compiled_again(damage, kind, filled):
    path = cached(filled, kind)
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    ended = called(filled)
    assert ended[:2] == (0, RIGHT), ended
    name = cached(filled, ".nbi").stem
    assert f"{path.parent} holds a damaged compiled filter, {name}; it" in ended.err
    assert called(filled) == (0, RIGHT, "")


def test_only_the_files_of_the_damaged_loop_go(filled):
    index = cached(filled, ".nbi")
    others = [index.with_name(name) for name in ("other.loop-2.py311.nbi", "notes.txt")]
    for path in others:
        path.write_bytes(b"")
    index.write_bytes(b"")
    assert called(filled).code == 0
    assert [path.exists() for path in others] == [True, True]


def test_a_cache_of_an_earlier_version_is_read_and_gets_its_checksum(filled):
    cached(filled, ".sha256").unlink()
    assert called(filled) == (0, RIGHT, "")
    assert cached(filled, ".sha256").is_file()


def test_a_cache_without_checksum_that_cannot_be_read_is_compiled_again(filled):
    cached(filled, ".sha256").unlink()
    cached(filled, ".nbc").write_bytes(b"")
    ended = called(filled)
    assert (ended.code, ended.out) == (0, RIGHT)
    assert "it is compiled again" in ended.err


def test_a_folder_in_the_place_of_a_file_leaves_the_loop_uncached(filled):
    path = cached(filled, ".nbi")
    path.unlink()
    path.mkdir()
    ended = called(filled)
    assert (ended.code, ended.out) == (0, RIGHT), ended
