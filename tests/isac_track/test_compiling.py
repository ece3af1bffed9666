"""Compiled loops and their cache, in a cache folder of its own and fresh processes."""

import shutil
from itertools import product

import numpy as np
import pytest
from helpers.commands import run

from isac_track.kalman._error_loops import fill_steps

HEAD = "from isac_track.compiling import compiled, read, written\n"
LOOP = """
@compiled(read(1), written(1))
def {name}(values, out):
    for place in range(values.size):
        out[place] = 2.0 * values[place]
"""
CALL = """\
import numpy as np, small_loop
for name in {names}:
    out = np.zeros(3)
    getattr(small_loop, name)(np.arange(3.0), out)
    print(out.tolist())
"""
RIGHT = "[0.0, 2.0, 4.0]\n"


def flipped(content):
    """Change a byte in fifty: the result may still load, and compute something else."""
    return bytes(
        byte ^ 0xA5 if place % 50 == 7 else byte for place, byte in enumerate(content)
    )


DAMAGES = {
    "empty": lambda _: b"",
    "cut short": lambda content: content[: len(content) // 2],
    "zeros in the middle": lambda content: (
        content[: len(content) // 3]
        + bytes(len(content) // 3)
        + content[2 * len(content) // 3 :]
    ),
    "flipped bytes": flipped,
}


CASES = {
    f"loop_{number}": case
    for number, case in enumerate(
        [*product(DAMAGES, (".nbi", ".nbc")), ("empty", ".sha256")]
    )
}
"""A loop for each damage, by its name."""


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loops")
    loops = (LOOP.format(name=name) for name in ("double", *CASES))
    (folder / "small_loop.py").write_text(HEAD + "".join(loops))
    assert called(folder, "double", *CASES).err.count("compiling filters, once") == 1
    # From the cache, without a message.
    assert called(folder, "double", *CASES) == (0, RIGHT * (1 + len(CASES)), "")
    shutil.copytree(folder / "cache", folder / "undamaged")
    return folder


@pytest.fixture
def filled(compiled_once):
    """The folder with an undamaged cache, which depends on the path of the source."""
    shutil.rmtree(compiled_once / "cache")
    shutil.copytree(compiled_once / "undamaged", compiled_once / "cache")
    return compiled_once


def called(folder, *names):
    """Call loops, each once, in a process of its own."""
    changed = {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    code = CALL.format(names=names or ("double",))
    code = f"import sys; sys.path.insert(0, {str(folder)!r})\n{code}"
    return run(folder, "-c", code, changed=changed)


def cached(folder, kind, *, name="double"):
    """The file of a loop in the cache."""
    (path,) = (folder / "cache").rglob(f"*.{name}-*{kind}")
    return path


@pytest.fixture(scope="module")
def damaged(compiled_once):
    """The cache folder, and two runs of all loops after all caches were damaged."""
    shutil.rmtree(compiled_once / "cache")
    shutil.copytree(compiled_once / "undamaged", compiled_once / "cache")
    for name, (damage, kind) in CASES.items():
        path = cached(compiled_once, kind, name=name)
        path.write_bytes(DAMAGES[damage](path.read_bytes()))
    first, second = (called(compiled_once, *CASES) for _ in range(2))
    return cached(compiled_once, ".nbi").parent, first, second


def test_loops_of_a_damaged_cache_compute_the_same(damaged):
    _, first, second = damaged
    assert first[:2] == (0, RIGHT * len(CASES)), first
    assert second == (0, RIGHT * len(CASES), "")


@pytest.mark.parametrize(
    "name", CASES, ids=[f"{damage}-{kind}" for damage, kind in CASES.values()]
)
def test_a_damaged_cache_is_compiled_again(name, damaged):
    folder, first, _ = damaged
    (line,) = [line for line in first.err.splitlines() if f"small_loop.{name}-" in line]
    assert line.startswith(f"isac-track: {folder} holds a damaged compiled filter, ")
    assert line.endswith("; it is compiled again")


def test_only_the_files_of_the_damaged_loop_are_removed(filled):
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


def test_arguments_of_other_types_are_refused_and_nothing_is_written():
    out = np.full((3, 5), 7.0)
    motion = np.array([1.0, np.inf, 0.1])
    with pytest.raises(TypeError, match="No matching definition"):
        fill_steps(np.arange(3.0), np.array([0.0, 3.0]), motion, out)
    assert (out == 7.0).all()
    fill_steps(np.arange(3.0), np.array([0, 3]), motion, out)
    assert not (out == 7.0).all()
