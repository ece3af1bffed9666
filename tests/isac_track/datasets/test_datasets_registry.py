# ruff: noqa: ARG001 - a fixture works by being asked for
import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from helpers.mirror import FAILS, OTHER, WALK, closed
from helpers.recordings import files_in

from isac_track.datasets import load, registry
from isac_track.datasets.registry import KNOWN, Known, fetch, file_url, locate
from isac_track.errors import DataError

SMALL = Known(name="small", sha256={"obsmat.txt": hashlib.sha256(WALK).hexdigest()})


def put(folder, name, *sources, **contents):
    (folder / name).mkdir(parents=True)
    for source in sources:
        shutil.copyfile(source, folder / name / source.name)
    for file_name, data in contents.items():
        (folder / name / f"{file_name}.txt").write_bytes(data)


def test_a_plain_import_and_the_help_stay_light():
    code = (
        "import sys; from isac_track.datasets.__main__ import _parser;"
        " _parser().format_help();print(*{'pandas', 'pooch', 'rich', 'pyarrow',"
        " 'scipy', 'requests', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""


def test_the_default_is_the_bundled_crowd_with_a_notice(mirror, monkeypatch, tmp_path):
    loaded = load()
    assert (loaded.name, loaded.simulated, loaded.repairs) == ("plaza", True, ())
    assert loaded.path == "isac_track/datasets/plaza.npz"
    assert (
        "students03 is not here (ISAC_TRACK_DATA is not set; cache is" in loaded.notice
    )
    assert "python -m isac_track.datasets fetch students03" in loaded.notice
    monkeypatch.setenv("ISAC_TRACK_DATA", str(tmp_path / "typo"))
    assert "typo, which is no folder" in load().notice
    assert mirror.asked == []  # never a network
    first, second = load("plaza"), load("plaza-session2")
    assert (first.notice, first.sha256 == second.sha256) == (None, False)
    assert all([first.citation, first.licence])


def test_the_default_takes_the_real_recording_if_it_is_here(ucy):
    loaded = load()
    assert (loaded.name, loaded.simulated, loaded.notice) == ("students03", False, None)
    assert loaded.path == str(ucy / "students03" / "obsmat.txt")
    assert loaded.sha256 == KNOWN["students03"].sha256["obsmat.txt"]
    assert "Lerner" in loaded.citation


def test_data_folder_before_cache(empty_machine, data_folder):
    for folder in (empty_machine, data_folder):
        put(folder, "small", obsmat=WALK)
        assert locate(SMALL)[0] == {"obsmat.txt": folder / "small" / "obsmat.txt"}


@pytest.mark.parametrize("name", [None, "students03"])
def test_a_wrong_file_is_an_error_with_both_hashes(name, ucy, data_folder):
    put(data_folder, "students03", ucy / "students03" / "groups.txt", obsmat=WALK)
    with pytest.raises(DataError) as caught:
        load(name)
    message, path = str(caught.value), data_folder / "students03" / "obsmat.txt"
    assert message.startswith(f"{path} is not the obsmat.txt of students03")
    assert hashlib.sha256(WALK).hexdigest() in message
    assert KNOWN["students03"].sha256["obsmat.txt"] in message
    assert "give its path, --format obsmat and --fps" in message
    # The way out that it names.
    assert load(path, format="obsmat", fps=25).tracks.t.size == 2


def test_students03_without_its_groups_is_an_error_not_other_intervals(
    ucy, data_folder
):
    put(data_folder, "students03", ucy / "students03" / "obsmat.txt")
    for name in (None, "students03"):
        with pytest.raises(
            DataError, match=r"students03: groups.txt not found; .*obsmat.txt is "
        ):
            load(name, download=False)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("student03", r"'student03' is neither .* did you mean students03\? .*zara01"),
        ("xyz", r"'xyz' is neither a known data set nor a file \(known: "),
        ("walk.csv", r"walk.csv: no such file"),
        ("walk\0.csv", r"no such file"),
        (os.sep, r"this is a folder"),
        ("pipe.csv", r"no such file"),  # does not hang
        ("x" * 5000 + ".csv", r"cannot be read .File name too long"),
    ],
)
def test_what_is_neither_a_name_nor_a_file(
    empty_machine, name, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.csv")
    with pytest.raises(DataError, match=message):
        load(name)


def test_a_known_data_set_takes_no_format_and_is_only_downloaded_if_it_may_be(mirror):
    for name in (None, "plaza", "students03"):
        with pytest.raises(DataError, match=r"leave --format, --fps and --unit out"):
            load(name, fps=25)
    with pytest.raises(DataError, match=r"zara01: obsmat.txt not found .*fetch zara01"):
        load("zara01", download=False)
    assert mirror.asked == []


def test_a_named_data_set_is_downloaded_once(ucy, mirror):
    for name in ("obsmat.txt", "groups.txt"):
        mirror.files[f"/base/students03/{name}"] = (
            ucy / "students03" / name
        ).read_bytes()
    first = load("students03")
    assert (len(first.tracks), first.notice) == (428, None)
    assert load("students03").path == first.path
    assert load().name == "students03"  # and is the default from now on
    assert mirror.asked == [
        "/base/students03/obsmat.txt",
        "/base/students03/groups.txt",
    ]


# A slow header leaves a thread behind.
@pytest.mark.parametrize("failure", [name for name in FAILS if name != "a slow header"])
def test_a_failed_download_is_one_line_and_leaves_nothing(
    failure, mirror, empty_machine, monkeypatch
):
    answer, message = FAILS[failure]
    monkeypatch.setattr(registry, "READ_TIMEOUT_S", 0.4)
    monkeypatch.setattr(registry, "LEAST_S", 2.0)
    mirror.files["/base/small/obsmat.txt"] = answer
    began = time.monotonic()
    with pytest.raises(DataError) as caught:
        fetch(SMALL)
    assert time.monotonic() - began < 5
    assert str(caught.value).startswith(f"{file_url(SMALL, 'obsmat.txt')}: {message}")
    assert "Way out: get obsmat.txt of that folder" in str(caught.value)
    assert "save in DIR/small and set ISAC_TRACK_DATA=DIR" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert files_in(empty_machine) == []


def test_what_a_killed_download_left_goes_and_that_of_another_process_stays(
    mirror, empty_machine
):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    put(empty_machine, "small")
    leftover, others = (
        empty_machine / "small" / f".obsmat.txt.{pid}"
        for pid in (ended.pid, os.getppid())
    )
    leftover.write_bytes(b"half")
    others.write_bytes(b"half")
    mirror.files["/base/small/obsmat.txt"] = WALK
    fetch(SMALL)
    assert {path.name for path in (empty_machine / "small").iterdir()} == {
        "obsmat.txt",
        others.name,
    }


def test_a_fetched_file_stays_and_only_a_good_file_replaces_a_damaged_one(
    mirror, empty_machine
):
    pair = replace(
        SMALL, sha256={**SMALL.sha256, "groups.txt": hashlib.sha256(b"1 2").hexdigest()}
    )
    put(empty_machine, "small", groups=OTHER)
    damaged = empty_machine / "small" / "groups.txt"
    mirror.files["/base/small/obsmat.txt"] = WALK
    for answer in (404, OTHER, FAILS["cut short"][0], closed):
        mirror.files["/base/small/groups.txt"] = answer
        with pytest.raises(DataError, match=r"small/groups.txt: .*Way out"):
            fetch(pair)
        assert {path.name: path.read_bytes() for path in files_in(empty_machine)} == {
            "obsmat.txt": WALK,
            "groups.txt": OTHER,
        }
    mirror.files["/base/small/groups.txt"] = b"1 2"
    assert set(fetch(pair)[0]) == {"obsmat.txt", "groups.txt"}
    assert damaged.read_bytes() == b"1 2"
    assert mirror.asked.count("/base/small/obsmat.txt") == 1


PROXY = {"http_proxy": "http://127.0.0.1:1", "NO_PROXY": "", "no_proxy": ""}


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"ISAC_TRACK_MIRROR": "ftp://127.0.0.1"}, "cannot be downloaded"),
        ({"ISAC_TRACK_MIRROR": "nonsense"}, "cannot be downloaded"),
        ({"ISAC_TRACK_MIRROR": "http://"}, "cannot be downloaded"),
        (PROXY, "the proxy refuses the connection. Way out"),
        (
            {"ISAC_TRACK_CACHE": __file__},
            r"obsmat.txt: cannot be written \(Not a directory\)",
        ),
    ],
)
def test_a_machine_that_is_not_set_up(mirror, monkeypatch, variables, message):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(DataError, match=message):
        fetch(SMALL)


def test_the_real_address_is_a_pinned_commit(monkeypatch):
    monkeypatch.delenv("ISAC_TRACK_MIRROR", raising=False)
    assert re.fullmatch(
        r"https://raw.githubusercontent.com/crowdbotp/OpenTraj/[0-9a-f]{40}/.*/zara01/groups.txt",
        file_url(KNOWN["zara01"], "groups.txt"),
    )
