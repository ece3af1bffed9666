"""Several files as sessions of one recording, and the people who come back."""

import os
from pathlib import Path

import numpy as np
import pytest

from evaluation.matrix import main
from isac_track.datasets import load
from isac_track.errors import DataError

T = np.arange(0.0, 24.0, 0.4)


def walk(person, *, marker=None, unit="m", step=10):
    """Rows of PeTrack: id, frame, x, y, z and the person's marker."""
    scale = {"m": 1.0, "cm": 100.0}[unit]
    return [
        f"{person} {n * step} {0.5 * t * scale:.4f} {person * scale:.4f} 1.7"
        + (f" {marker}" if marker else "")
        for n, t in enumerate(T)
    ]


def petrack(path, people, *, marked=True, unit="m", rate=25, step=10):
    names = f"# id frame x/{unit} y/{unit} z/{unit}"
    if marked:
        names += " markerID"
    rows = [
        row
        for person, marker in people
        for row in walk(person, marker=marker, unit=unit, step=step)
    ]
    # The name of the file makes its bytes unique.
    lines = [f"# framerate: {rate}", f"# {path.stem}", names, *rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def csv(path, people):
    rows = [f"{t:.2f},{person},{0.5 * t:.4f},{person}" for person in people for t in T]
    path.write_text("\n".join(["t,id,x,y", *rows]) + "\n")
    return path


def test_a_marker_is_the_person_whatever_the_id_and_heights_are_never_used(tmp_path):
    petrack(tmp_path / "a.txt", [(1, 701), (2, 702)])
    petrack(tmp_path / "b.txt", [(1, 702), (2, 703)])
    dataset = load(tmp_path)
    tracks = dataset.tracks
    assert tracks.source == ("a:1", "a:2", "b:1", "b:2")
    assert tracks.person == ("701", "702", "702", "703")
    assert tracks.session == ("a", "a", "b", "b")
    assert len(set(tracks.group)) == 3  # one person is one cluster of every interval
    assert tracks.group[1] == tracks.group[2]
    assert tracks.xy[:, 1].tolist() == np.repeat([1.0, 2.0, 1.0, 2.0], T.size).tolist()
    # One session after the other, so that nobody is there in both at once.
    assert tracks.t[tracks.offsets[2]] == pytest.approx(T[-1] + 60.0)
    taller = (tmp_path / "b.txt").read_text().replace(" 1.7 ", " 2.1 ")
    (tmp_path / "b.txt").write_text(taller)
    assert np.array_equal(load(tmp_path).tracks.xy, tracks.xy)
    assert load(tmp_path).sha256 != dataset.sha256


def test_a_person_without_a_marker_is_not_known_in_another_session(tmp_path):
    petrack(tmp_path / "a.txt", [(1, -1), (2, 702), (3, -1)])
    petrack(tmp_path / "b.txt", [(1, -1), (2, 702)])
    tracks = load(tmp_path).tracks
    assert len(tracks) == 5
    rows = [tracks.source.index(row) for row in ("a:2", "b:2")]
    assert len({tracks.person[row] for row in rows}) == 1
    assert len(set(tracks.person)) == len(set(tracks.group)) == 4


def test_ids_are_other_people_in_another_file_unless_it_is_said_that_they_last(
    tmp_path,
):
    files = [csv(tmp_path / "a.csv", (1, 2)), csv(tmp_path / "b.csv", (2, 3))]
    apart, same = (
        load(sessions=files, persistent_ids=lasting) for lasting in (False, True)
    )
    assert (apart.tracks.person, len(set(apart.tracks.group))) == (None, 4)
    assert same.tracks.person == ("1", "2", "2", "3")
    assert len(set(same.tracks.group)) == 3
    assert apart.name == tmp_path.name
    assert apart.sha256 == load(tmp_path).sha256


@pytest.mark.parametrize(
    ("second", "options", "message"),
    [
        ({"unit": "cm"}, [], "sessions a and b are in m and cm"),
        ({"rate": 50}, [], "have a sample every 0.4 and 0.2 s"),
        (
            {"marked": False},
            [],
            "sessions a and b: the first alone names people",
        ),
        (
            {"people": [(1, 701), (2, 701)]},
            [],
            "person 701 walks passage 2 from 0 s on and passage 1 (line 4) until 23.6 s",
        ),
        (
            {},
            ["--task", "cross_session"],
            "2 people walk for 12 s in two sessions, but it takes 8",
        ),
        ({"name": "a.csv"}, [], "two sessions are called a"),
        (None, ["--persistent-ids"], "--persistent-ids is of sessions"),
    ],
)
def test_sessions_that_do_not_fit_are_one_line_and_2(
    second, options, message, tmp_path, capsys
):
    people = [(1, 701), (2, 702)]
    first = petrack(tmp_path / "a.txt", people)
    words = ["--dataset", str(first)]
    if second is not None:
        words = ["--dataset", str(tmp_path)]
        name = second.pop("name", "b.txt")
        if name.endswith("csv"):
            csv(tmp_path / name, (1, 2))
        else:
            marked = second.get("marked", True)
            unmarked = [(person, None) for person, _ in people]
            petrack(
                tmp_path / name, **({"people": people if marked else unmarked} | second)
            )
    assert main([*words, *options, "--out", str(tmp_path / "out"), "--jobs", "1"]) == 2
    output = capsys.readouterr().err
    error = output[output.index("error:") :]
    assert message in " ".join(error.split())
    assert not (tmp_path / "out").exists()


def test_what_is_no_set_of_sessions(tmp_path):
    path = csv(tmp_path / "a.csv", (1,))
    for options in ({"sessions": [path]}, {"name": "plaza", "sessions": [path, path]}):
        with pytest.raises(
            DataError, match="two files or more, and the place of --dataset"
        ):
            load(**options)
    (tmp_path / "empty").mkdir()
    with pytest.raises(
        DataError, match=r"this is a folder, and holds no session \(.csv"
    ):
        load(tmp_path / "empty")


def test_single_file_experiments_and_a_further_run_of_theirs(single_file, data_folder):
    for path in single_file.glob("*.txt"):
        (data_folder / "singlefile").mkdir(exist_ok=True)
        (data_folder / "singlefile" / path.name).symlink_to(path)
    dataset = load("singlefile")
    assert (len(dataset.tracks), len(set(dataset.tracks.person)), dataset.notice) == (
        48,
        20,
        None,
    )
    text = (single_file / "croma_female_04_1.txt").read_text()
    further = data_folder / "singlefile" / "croma_female_24_1.txt"
    further.write_text(text + "\n")
    assert (
        load("singlefile").notice == "singlefile: no known hash: croma_female_24_1.txt"
    )
    further.rename(data_folder / "singlefile" / "croma_female_04_1.txt")
    (data_folder / "singlefile" / "croma_female_04_1.txt").write_text(text + "\n\n")
    with pytest.raises(
        DataError, match=r"is not the croma_female_04_1.txt of singlefile"
    ):
        load("singlefile")


def test_a_copy_is_no_session(tmp_path):
    rows = "".join(
        f"{0.4 * i},{person},{i},{person}\n" for person in range(3) for i in range(60)
    )
    paths = [tmp_path / name for name in ("monday.csv", "tuesday.csv", "copy.csv")]
    for path, added in zip(paths, ("", "30.0,9,1,1\n30.4,9,1,2\n", ""), strict=True):
        path.write_text(f"t,id,x,y\n{rows}{added}")
    assert len(load(sessions=paths[:2]).tracks) > 0
    with pytest.raises(DataError, match="hold the same bytes"):
        load(sessions=paths)


def test_the_bytes_of_a_known_recording_under_another_rate_get_a_notice(tmp_path):
    if not (
        Path(os.environ.get("ISAC_TRACK_DATA", "/nowhere")) / "zara01" / "obsmat.txt"
    ).is_file():
        pytest.skip("needs zara01 in the folder that ISAC_TRACK_DATA names")
    copy = tmp_path / "street.txt"
    copy.write_bytes(
        (Path(os.environ["ISAC_TRACK_DATA"]) / "zara01" / "obsmat.txt").read_bytes()
    )
    dataset = load(copy, format="obsmat", fps=50.0)
    assert "the bytes of zara01, recorded at 25 frames/s, read at 50" in dataset.notice
    assert load(copy, format="obsmat", fps=25.0).notice is None
