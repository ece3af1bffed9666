"""Machines with other settings: the same bytes, or one line before a run begins."""

import os
import resource
import subprocess
from pathlib import Path

import pytest
from helpers.commands import (
    FEW,
    MATRIX,
    UNDRAWN,
    assert_refused,
    assert_same,
    content,
    run,
)
from helpers.small_runs import write_walks

pytestmark = pytest.mark.slow

NOWHERE = "/nowhere/at/all"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("environments")
    write_walks(folder / "walks.csv", n_people=24)
    assert matrix(folder, folder / "usual").code == 0
    return folder


def matrix(folder, out, *options, command=MATRIX, **how):
    words = (*FEW, "--scenes", 8, "--dataset", folder / "walks.csv", "--out", out)
    return run(folder, *command, *words, *options or ("--jobs", 1), **how)


SAME = {
    # What else the environment says; None takes a name out of it.
    "no language": {
        "LC_ALL": "C",
        "LANG": None,
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
    },
    "a language that is not there": {"LC_ALL": "tr_TR.ISO-8859-9", "LANG": "xx_YY"},
    "a terminal of ASCII": {
        "PYTHONIOENCODING": "ascii",
        "TERM": "dumb",
        "NO_COLOR": "1",
    },
    "a terminal of Latin-1, in colour": {
        "PYTHONIOENCODING": "latin-1",
        "FORCE_COLOR": "1",
    },
    "a narrow terminal": {"COLUMNS": "20", "LINES": "3"},
    "columns that are no number": {"COLUMNS": "many"},
    "no columns": {"COLUMNS": "0"},
    "no home": {"HOME": NOWHERE, "XDG_CACHE_HOME": NOWHERE, "MPLCONFIGDIR": None},
    "no home at all": {"HOME": None, "USER": None, "LOGNAME": None},
    "nowhere for temporary files": {"TMPDIR": NOWHERE, "TEMP": NOWHERE, "TMP": NOWHERE},
    "a backend without a window": {"MPLBACKEND": "svg"},
    "a backend for a window": {"MPLBACKEND": "TkAgg", "DISPLAY": ":77"},
    "another clock": {"TZ": "Pacific/Kiritimati", "SOURCE_DATE_EPOCH": "0"},
    "warnings that are errors": {"PYTHONWARNINGS": "error"},
    "hashes of another order": {"PYTHONHASHSEED": "12345"},
    "no network": {
        "http_proxy": "http://127.0.0.1:1",
        "https_proxy": "http://127.0.0.1:1",
    },
    "many threads": {
        "OMP_NUM_THREADS": "64",
        "OPENBLAS_NUM_THREADS": "64",
        "MKL_NUM_THREADS": "x",
    },
    "a folder of data that is not there": {
        "ISAC_TRACK_DATA": NOWHERE,
        "ISAC_TRACK_CACHE": "",
    },
    "only one's own search path": {
        "PYTHONNOUSERSITE": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    },
}


@pytest.mark.parametrize("case", SAME)
def test_the_same_bytes_with(case, place, tmp_path):
    ended = matrix(place, tmp_path / "run", changed=SAME[case])
    assert (ended.code, bool(ended.out)) == (0, True), ended
    assert_same(tmp_path / "run", content(place / "usual"))


def test_a_folder_may_have_the_short_name_of_home(place):
    for _ in range(2):
        assert matrix(place, "~/run").code == 0
        assert_same(place / "~" / "run", content(place / "usual"))


PROCESSES = {
    "nobody who reads": {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL},
    "no standard input": {"preexec_fn": lambda: os.close(0), "stdin": None},
    "no standard output": {"preexec_fn": lambda: os.close(1), "stdout": None},
    "no standard streams": {
        "preexec_fn": lambda: os.closerange(0, 3),
        **dict.fromkeys(("stdin", "stdout", "stderr")),
    },
    "few open files": {
        "preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    },
    "files for oneself alone": {"preexec_fn": lambda: os.umask(0o077) and None},
}


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("case", PROCESSES)
def test_the_same_bytes_in_a_process_with(case, jobs, place, tmp_path):
    out, usual = tmp_path / "run", content(place / "usual")
    ended = matrix(place, out, "--jobs", jobs, command=UNDRAWN, **PROCESSES[case])
    assert ended.code == 0, ended
    assert_same(
        out, {name: held for name, held in usual.items() if "figures/" not in name}
    )


def test_a_folder_that_is_gone_is_one_line(tmp_path):
    code = "import os, sys; os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')\n"
    code += UNDRAWN[1].replace("import sys; ", "")
    assert_refused(run(tmp_path, "-c", code, "--dataset", "plaza"))


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_no_room_for_what_is_said(stream, place, tmp_path):
    with Path("/dev/full").open("w") as full:
        ended = matrix(place, tmp_path / "run", **{stream: full})
    assert ended.code == 2
    if stream == "stdout":
        assert_refused(ended, "the output cannot be written", "send it elsewhere")
    assert matrix(place, tmp_path / "run").code == 0
    assert_same(tmp_path / "run", content(place / "usual"))
