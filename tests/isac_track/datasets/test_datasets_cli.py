# ruff: noqa: ARG001 - a fixture works by being asked for
import hashlib

import pytest
from helpers.recordings import files_in

from isac_track.datasets import registry
from isac_track.datasets.__main__ import main


@pytest.mark.parametrize("width", [80, 120])
def test_the_table_lines_up(width, empty_machine, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    table = lines[: lines.index("")]
    assert {len(line) for line in table} == {len(table[0])}
    assert len(table[0]) <= width
    assert (
        " ".join(table[0].split())
        == "data set tracks >=12 s >=21.6 s median s m/s zero frozen"
    )
    assert "…" not in "".join(table)
    names = [line.split()[0] for line in table[1:]]
    assert names == [*registry.KNOWN]
    assert table[1].split()[1:] == ["-"] * 7
    # Columns end where their headers end.
    assert (
        table[-1].rindex("0", 0, table[0].index("frozen") + 6)
        == table[0].index("frozen") + 5
    )
    assert "not here; `python -m isac_track.datasets fetch zara01`" in "\n".join(lines)


def test_the_list_of_what_is_here(ucy, capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    row = next(line for line in out.splitlines() if line.startswith("students03 "))
    assert row.split() == [
        "students03",
        "428",
        "276",
        "106",
        "14.8",
        "0.80",
        "18.7%",
        "5",
    ]
    assert str(ucy / "students03" / "obsmat.txt") in out


def test_the_list_goes_on_behind_a_damaged_file(empty_machine, capsys):
    (empty_machine / "zara01").mkdir(parents=True)
    (empty_machine / "zara01" / "obsmat.txt").write_text("other")
    assert main([]) == 2
    out = capsys.readouterr().out
    assert "error: " in out
    assert "is not the obsmat.txt of zara01" in out
    assert "plaza.npz" in out


def test_show_with_repairs(tmp_path, capsys):
    path = tmp_path / "[red]walk.csv"
    path.write_text("t,id,x,y\n0.4,1,0.4,0\n0,1,0,0\n0,1,0,0\n0.8,1,0.4,0\n0,2,0,0\n")
    assert main(["show", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"path         {path}" in out  # not taken for markup
    assert "1 in 1 groups, 3 samples" in out
    assert "50.0% of all steps have exactly no length" in out
    assert f"1 unsorted       {path}: line 3: earlier" in out
    assert f"1 duplicate      {path}: line 4: the same id" in out
    assert f"1 one-point      {path}: line 6: a single sample" in out
    steps = next(
        line for line in out.splitlines() if line.startswith("steps of no length")
    )
    assert steps.split()[-5:] == [
        c for c in steps.split() if c not in "steps of no length │"
    ]


def test_show_takes_format_and_fps(tmp_path, capsys):
    path = tmp_path / "walk.txt"
    path.write_text("0 1 0 0\n10 1 0.4 0\n")
    assert main(["show", str(path), "--format", "social-gan", "--fps", "25"]) == 0
    assert "format       social-gan" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["show", "student03"],
            "'student03' is neither a known data set nor a file; did you",
        ),
        (
            ["fetch", "student03"],
            "'student03' is neither a known data set nor a file; did you",
        ),
        (["fetch", "zara01"], "http://127.0.0.1:1/zara01/obsmat.txt: no connection"),
        (["nonsense"], "--help"),
        (["show"], "--help"),
        (["show", "a", "--fps", "fast"], "--help"),
    ],
)
def test_a_mistake_is_one_line_and_2(arguments, message, empty_machine, capsys):
    assert main(arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("error: ")
    assert message in shown.err
    assert shown.err.count("\n") == 1
    assert files_in(empty_machine) == []


def test_fetch(mirror, empty_machine, monkeypatch, capsys):
    small = registry.Known(
        "small", sha256={"obsmat.txt": hashlib.sha256(b"1 2").hexdigest()}
    )
    monkeypatch.setattr(registry, "KNOWN", registry.KNOWN | {"small": small})
    mirror.files["/base/small/obsmat.txt"] = b"1 2"
    target = empty_machine / "small" / "obsmat.txt"
    assert main(["fetch", "small", "plaza"]) == 0
    shown = capsys.readouterr()
    assert shown.err == f"downloading {mirror.address}small/obsmat.txt\n"
    expected = f"small: fetched: {target}\nplaza is bundled: nothing to fetch\n"
    assert shown.out == expected
    assert main(["fetch", "small"]) == 0
    assert f"small: already here: {target}" in capsys.readouterr().out
    assert len(mirror.asked) == 1
