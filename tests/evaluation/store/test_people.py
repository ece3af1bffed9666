"""What people are called in a run folder, and what of it may be passed on."""

import hashlib
import json
import shutil
import stat
from types import SimpleNamespace

import pandas as pd
import pyarrow.parquet as pq
import pytest
from helpers.commands import assert_refused
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation import matrix, publish, report
from evaluation.store.manifest import read_manifest
from evaluation.store.people import in_first_half, pseudonym, read_labels
from evaluation.store.public_text import public_path, public_words, without_folders
from isac_track.errors import DataError, SettingsError

NUMBERS = (
    "summary",
    "frontier",
    "matched",
    "linkability",
    "gallery",
    "decisions",
    "curves",
)
AXES = {
    "mechanisms": ("raw", "fixed:0.7"),
    "predictors": ("least_squares",),
    "attacks": ("radial_rts", "shape"),
    "tasks": ("rerelease", "new_traversal"),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The same run with pseudonyms, and with the recording's own ids: names."""
    folder = tmp_path_factory.mktemp("home-of-anna")
    write_walks(folder / "walks.csv", n_people=40)
    rows = pd.read_csv(folder / "walks.csv")
    rows["id"] = [f"Citizen{item}" for item in rows["id"]]
    lone = rows.tail(1).assign(
        id="CitizenLone"
    )  # both are repairs, which the files of a run tell
    rows = pd.concat([rows.drop(index=rows.index[20]), lone])
    rows.to_csv(folder / "walks.csv", index=False)
    for name in ("run", "kept"):
        settings = smoke(
            folder / "walks.csv", folder / name, **AXES, keep_ids=name == "kept"
        )
        evaluation.run(settings, progress=False, pictures=name == "run")
    return folder


def holding(folder, text):
    """Files of a folder that hold a text, whole parquet columns included."""
    result = []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        content = path.read_bytes()
        if path.suffix == ".parquet":
            content += str(pq.read_table(path).to_pydict()).encode()
        if text.encode() in content:
            result.append(path.name)
    return result


def test_no_id_and_no_folder_is_in_any_file_but_the_private_one(runs):
    assert holding(runs / "run", "Citizen") == []
    assert holding(runs / "run", "home-of-anna") == ["private.json"]
    assert "people.json" in holding(runs / "kept", "Citizen")


def test_what_was_mended_is_told_without_the_folder(runs):
    repairs = read_manifest(runs / "run")["dataset"]["repairs"]
    message = {repair["kind"]: repair["detail"] for repair in repairs}
    assert {"gap", "one-point"} <= {*message}
    assert all(
        message[kind].startswith("walks.csv: line ") for kind in ("gap", "one-point")
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/home/anna b/rec/a.csv: line 3: cut", "a.csv: line 3: cut"),
        ("/home/anna b/rec/c.csv: line 3: cut", "rec/c.csv: line 3: cut"),
        (
            "ISAC_TRACK_DATA is /srv/anna/data; cache is /home/anna b/.cache",
            "data; cache is .cache",
        ),
        ("walks.csv: line 3: 1.25/2.5", "walks.csv: line 3: 1.25/2.5"),
    ],
)
def test_a_text_about_a_recording_names_no_folder(text, expected, monkeypatch):
    monkeypatch.setenv("ISAC_TRACK_DATA", "/srv/anna/data")
    monkeypatch.setenv("ISAC_TRACK_CACHE", "/home/anna b/.cache")
    data = SimpleNamespace(
        path="/home/anna b/rec", sessions=("/home/anna b/rec/a.csv",)
    )
    assert without_folders(text, data).removeprefix("ISAC_TRACK_DATA is ") == expected


def test_the_key_is_for_its_owner_alone(runs):
    mode = stat.S_IMODE((runs / "run" / "private.json").stat().st_mode)
    assert mode == 0o600


@pytest.mark.parametrize("name", NUMBERS)
def test_no_number_depends_on_what_people_are_called(name, runs):
    with_pseudonyms, with_ids = (
        runs / item / f"{name}.csv" for item in ("run", "kept")
    )
    assert with_pseudonyms.read_bytes() == with_ids.read_bytes()
    with_pseudonyms, with_ids = (
        runs / item / "verdict.json" for item in ("run", "kept")
    )
    assert with_pseudonyms.read_bytes() == with_ids.read_bytes()


def test_two_keys_give_two_names_and_one_key_one():
    first, second = "00" * 32, "ff" * 32
    assert pseudonym("7", first) == pseudonym("7", first) != pseudonym("7", second)
    # RFC 4231, test case 2, whose key is text.
    assert (
        pseudonym("what do ya want for nothing?", b"Jefe".hex()) == "5bdcc146bf60754e"
    )


def test_labels_sort_as_ids_do_and_carry_the_half_of_the_people(runs):
    ids = json.loads((runs / "kept" / "people.json").read_text())
    assert sorted(ids) == sorted(ids, key=ids.__getitem__)
    for name, label in ids.items():
        assert in_first_half(label) == in_first_half(name)
        assert in_first_half(name) == (
            hashlib.sha256(name.encode()).digest()[0] % 2 == 0
        )
    assert [*read_labels(runs / "run").values()] == [*ids.values()]
    groups = read_manifest(runs / "run")["groups"]
    assert groups == sorted(groups) == read_manifest(runs / "kept")["groups"]


def test_a_run_that_lost_a_cell_continues_to_the_same_bytes(runs, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(runs / "run", out)
    before = {path.name: path.read_bytes() for path in (out / "cells").iterdir()}
    (out / "cells" / min(before)).unlink()
    (out / "gallery.parquet").unlink()
    evaluation.run(
        smoke(runs / "walks.csv", out, **AXES), progress=False, pictures=False
    )
    assert {
        path.name: path.read_bytes() for path in (out / "cells").iterdir()
    } == before
    for name in ("gallery.parquet", "people.json"):
        assert (out / name).read_bytes() == (runs / "run" / name).read_bytes()


def test_without_its_key_a_run_is_not_continued(runs, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(runs / "run", out)
    (out / "private.json").unlink()
    with pytest.raises(DataError, match="key of this run's pseudonyms is missing"):
        evaluation.run(smoke(runs / "walks.csv", out, **AXES), progress=False)
    (out / "private.json").write_text("{")
    with pytest.raises(DataError, match=r"private.json cannot be read"):
        evaluation.run(smoke(runs / "walks.csv", out, **AXES), progress=False)


def test_ids_and_pseudonyms_are_not_mixed_in_a_folder(runs):
    settings = smoke(runs / "walks.csv", runs / "run", **AXES, keep_ids=True)
    with pytest.raises(SettingsError, match="holds another run"):
        evaluation.run(settings, progress=False)


def test_a_published_copy_tells_the_same_and_nothing_private(runs, ran, tmp_path):
    to = tmp_path / "copy"
    ended = ran(publish, runs / "run", "--to", to)
    assert (ended.code, ended.err) == (0, "")
    for text in ("Citizen", "home-of-anna", "true walks of real people"):
        assert holding(to, text) == []
    assert not {"private.json", "gallery.parquet"} & {
        path.name for path in to.iterdir()
    }
    assert "<section id=gallery" not in (to / "report.html").read_text()
    before = (to / "summary.csv").read_bytes()
    assert before == (runs / "run" / "summary.csv").read_bytes()
    assert ran(report, to).code == 0
    assert (to / "summary.csv").read_bytes() == before


def test_what_cannot_be_published_is_one_line(runs, ran, tmp_path):
    assert_refused(
        ran(publish, runs / "kept", "--to", tmp_path / "a"), "without --keep-ids"
    )
    assert_refused(ran(publish, tmp_path / "nothing"), "holds no run")
    (tmp_path / "there").mkdir()
    assert_refused(ran(publish, runs / "run", "--to", tmp_path / "there"), "exists")
    assert not (tmp_path / "a").exists()


def test_the_page_says_that_it_shows_real_walks(runs):
    assert "true walks of real people" in (runs / "run" / "report.html").read_text()


def test_without_pictures_no_walks_are_kept(runs, ran, tmp_path):
    words = [
        "--preset",
        "smoke",
        "--scenes",
        8,
        "--jobs",
        1,
        "--dataset",
        runs / "walks.csv",
    ]
    words += [
        "--attack",
        "none",
        "--task",
        "none",
        "--mechanism",
        "raw",
        "--no-pictures",
    ]
    assert ran(matrix, *words, "--out", tmp_path / "run").code == 0
    left = {path.name for path in (tmp_path / "run").iterdir()}
    assert left & {"gallery.parquet", "report.html", "figures"} == set()


def test_a_recording_that_must_not_be_passed_on_draws_no_walks(
    runs, monkeypatch, tmp_path
):
    monkeypatch.setattr("evaluation.pool.execute.NOT_PASSED_ON", "")  # in every licence
    few = AXES | {"attacks": ("radial_rts",), "tasks": ()}
    settings = smoke(runs / "walks.csv", tmp_path / "run", **few)
    evaluation.run(settings, progress=False, pictures=False)
    assert not (tmp_path / "run" / "gallery.parquet").exists()


def test_paths_are_told_below_the_working_folder_or_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert public_path(tmp_path / "data" / "walks.csv") == "data/walks.csv"
    assert public_path("/home/anna/walks.csv") == "walks.csv"
    given = [
        "/opt/bin/matrix.py",
        "--dataset=/home/anna/w.csv",
        "--out",
        "../../anna/run",
        "raw",
    ]
    assert public_words(given) == [
        "matrix.py",
        "--dataset=w.csv",
        "--out",
        "run",
        "raw",
    ]
    assert public_words([]) == [""]
