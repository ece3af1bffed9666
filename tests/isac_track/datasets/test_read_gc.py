"""Grand Central: an archive or a folder of annotations in pixels, from anywhere."""

import io
import json
import subprocess
import tarfile
from dataclasses import replace

import numpy as np
import pytest
from helpers.recordings import kinds, same

from isac_track.datasets import load, read_gc, registry
from isac_track.datasets.__main__ import main
from isac_track.errors import DataError

H = [[0.05, 0.0, 1.0], [0.0, 0.1, -2.0], [0.001, 0.0, 1.0]]


def annotation(*rows):
    return "".join(f"{x}\n{y}\n{frame}\n" for x, y, frame in rows).encode()


# A walk, a walk that goes on behind a gap of two annotations, and a leap.
FILES = {
    "datasets/GC/H.json": json.dumps({"homog": H}).encode(),
    "datasets/GC/Annotation/000007.txt": annotation(
        (100, 50, 40), (110, 50, 60), (120, 52, 80)
    ),
    "datasets/GC/Annotation/000012.txt": annotation(
        *((10 * n, 5, 20 * n) for n in range(3)),
        *((10 * n, 5, 20 * n) for n in range(4, 7)),
    ),
    "datasets/GC/Annotation/000013.txt": annotation(
        (0, 0, 0), (100, 0, 20), (110, 0, 40)
    ),
    "datasets/GC/ReadMe.md": b"about",
}


def archive(path, files=FILES, *, added=(), mode="w:gz"):
    with tarfile.open(path, mode) as tar:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
        for member in added:
            tar.addfile(member, io.BytesIO(b"0" * member.size))
    return path


def folder(path, files=FILES):
    for name, data in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(data)
    return path


def test_an_archive_and_its_folder_are_the_same_recording(tmp_path):
    packed = load(archive(tmp_path / "gc.tgz"), format="gc")
    unpacked = load(folder(tmp_path / "own"), format="gc")
    assert same(packed.tracks, unpacked.tracks)
    assert same(
        packed.tracks, load(tmp_path / "own" / "datasets" / "GC", format="gc").tracks
    )
    assert packed.sha256 == unpacked.sha256
    assert packed.tracks.source == ("7", "12#1", "12#2", "13")
    assert packed.tracks.group == ("7", "12", "12", "13")
    counts = kinds(packed.repairs)
    assert (counts["split"], counts["fast-track"]) == (1, 1)
    assert any(
        "tracks 13: a step above 4 m/s" in repair.detail for repair in packed.repairs
    )
    # By hand: (x', y', w) = H (x, y, 1), and 25 frames a second from the first frame.
    np.testing.assert_allclose(packed.tracks.xy[0], [6.0 / 1.1, 3.0 / 1.1], rtol=1e-12)
    np.testing.assert_allclose(packed.tracks.t[:3], [1.6, 2.4, 3.2], rtol=1e-12)


def test_the_digest_is_that_of_sha256sum(tmp_path):
    root = folder(tmp_path) / "datasets" / "GC"
    command = "LC_ALL=C sha256sum Annotation/*.txt H.json | sha256sum"
    done = subprocess.run(
        command, shell=True, cwd=root, capture_output=True, check=True, text=True
    )
    assert load(root, format="gc").sha256 == done.stdout.split()[0]


def member(name, *, size=0, kind=tarfile.REGTYPE, to=""):
    info = tarfile.TarInfo(name)
    info.size, info.type, info.linkname = size, kind, to
    return info


@pytest.mark.parametrize(
    ("added", "message"),
    [
        (
            member("x", kind=tarfile.SYMTYPE, to="/etc/passwd"),
            "'x' is a link or a device",
        ),
        (
            member("x", kind=tarfile.LNKTYPE, to="datasets/GC/H.json"),
            "'x' is a link or a device",
        ),
        (member("x", kind=tarfile.FIFOTYPE), "'x' is a link or a device"),
        (member("a/../../Annotation/1.txt"), "leads out of the archive"),
        (member("/tmp/Annotation/1.txt"), "leads out of the archive"),
        (member("other/H.json", size=9), "two files are called H.json"),
        (
            member("Annotation/2.txt", size=1_000_001),
            "has 1000001 bytes: not Grand Central",
        ),
        (
            member("Annotation/2.txt", size=4),
            "Annotation/2.txt: 1 numbers, not x, y and frame",
        ),
        (member("Annotation/2.txt", size=0), None),
        (member("\x1b[31m\n", kind=tarfile.SYMTYPE), "'?[31m?' is a link or a device"),
    ],
)
def test_a_member_that_should_not_be_there(added, message, tmp_path):
    path = archive(tmp_path / "gc.tgz", added=[added])
    if message is None:
        assert len(load(path, format="gc").tracks) == 4
        return
    with pytest.raises(DataError) as caught:
        load(path, format="gc")
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    # Nothing is ever unpacked.
    assert [file.name for file in tmp_path.iterdir()] == ["gc.tgz"]


def test_limits_end_a_bomb_and_a_crowd_of_members_without_reading_on(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(read_gc, "MOST_BYTES", 100_000)
    monkeypatch.setattr(read_gc, "MOST_MEMBERS", 50)
    for name, added, message in (
        (
            "size",
            [member(f"map{n}.xml", size=60_000) for n in range(2)],
            "to over 100000 bytes",
        ),
        # A name as long is read whole.
        ("name", [member("n" * 200_000)], "to over 100000 bytes"),
        ("count", [member(f"{n}") for n in range(60)], "over 50 members"),
    ):
        with pytest.raises(DataError, match=message):
            load(archive(tmp_path / name, added=added), format="gc")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"H.json": None}, "no H.json"),
        ({"H.json": b"{"}, 'no 3 x 3 numbers under "homog"'),
        ({"H.json": b'{"homog": [[1, 2, 3]]}'}, 'no 3 x 3 numbers under "homog"'),
        ({"H.json": b'{"homog": [[1,0,0],[0,1,0],[0,0,-1]]}'}, "beyond the horizon"),
        (
            {"Annotation/000007.txt": b"1 2 x"},
            "Annotation/000007.txt: not numbers alone",
        ),
        ({"Annotation/000007.txt": b"1 2 nan"}, "pedestrian 7: frame is nan"),
        (
            {"Annotation/000007.txt": b"1 2 3 9 2 3"},
            "pedestrian 7: id 7 is somewhere else",
        ),
    ],
)
def test_what_is_wrong_in_a_file_is_named(change, message, tmp_path):
    files = FILES | {f"datasets/GC/{name}": data for name, data in change.items()}
    path = archive(
        tmp_path / "gc.tgz",
        {name: content for name, content in files.items() if content is not None},
    )
    with pytest.raises(DataError, match=message):
        load(path, format="gc")


def test_what_is_no_archive(tmp_path):
    whole = archive(tmp_path / "gc.tgz").read_bytes()
    for name, data in (
        ("cut", whole[:-40]),
        ("text", b"walk"),
        ("tar", b"0" * 2000),
        ("no", b""),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(
            DataError, match=r"not an archive that can be read|no H.json"
        ):
            load(tmp_path / name, format="gc")
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "empty", tmp_path / "nowhere"):
        with pytest.raises(DataError, match=r"H.json"):
            load(path, format="gc")


def test_by_name_it_must_be_the_recording_and_may_be_a_link(
    data_folder, monkeypatch, capsys
):
    assert main(["fetch", "gc"]) == 2
    output = capsys.readouterr().err
    assert output.startswith("error: gc: no licence is issued")
    assert "ISAC_TRACK_DATA=DIR" in output
    (data_folder / "elsewhere").mkdir()
    archive(data_folder / "elsewhere" / "gc.tgz")
    (data_folder / "gc").symlink_to(data_folder / "elsewhere")
    with pytest.raises(DataError, match=r"is not the folder of gc: sha256 is"):
        load("gc")
    digest = load(data_folder / "gc", format="gc").sha256
    known = replace(registry.KNOWN["gc"], sha256={registry.WHOLE: digest})
    monkeypatch.setattr(registry, "KNOWN", {**registry.KNOWN, "gc": known})
    assert (load("gc").name, load("gc").sha256) == ("gc", digest)
    assert main(["fetch", "gc"]) == 0
    with pytest.raises(DataError, match="leave --fps out"):
        load(data_folder / "gc", format="gc", fps=25)


@pytest.mark.usefixtures("gc")
def test_grand_central_itself():
    dataset = load("gc")
    assert (len(dataset.tracks), len(set(dataset.tracks.group))) == (17_865, 12_682)
    assert kinds(dataset.repairs)["fast-track"] == 2175
    np.testing.assert_allclose(
        np.ptp(dataset.tracks.xy, axis=0), [28.1, 73.0], atol=0.05
    )
