"""A recording of one's own: what was made of it is told."""

import numpy as np

from evaluation import matrix


def test_what_was_made_of_a_recording_is_told_at_once_in_tables_and_on_the_page(
    tmp_path, capsys
):
    """26 people at 1 m/s in mm, 5 for 30 s: a gap, a split, a lost row, a lone row."""
    people = [(name, 30.0 if name < 5 else 18.0) for name in range(26)]
    rows = [
        f"{t:.1f},{name},{1000 * t:.0f},{300 * name}"
        for name, seconds in people
        for t in np.arange(0.0, seconds, 0.4)
        if not (name == 0 and abs(t - 4.0) < 0.1) and not (name == 9 and 3.0 < t < 8.0)
    ]
    path, out = tmp_path / "walks.csv", tmp_path / "run"
    path.write_text("\n".join(["t,id,x,y", *rows, "0,30,0,0"]), encoding="utf-8")
    words = ["--dataset", path, "--unit", "mm", "--scenes", "8", "--mechanism", "raw"]
    words += ["--predictor", "none", "--attack", "none", "--task", "none", "--out", out]
    assert matrix.main([*map(str, words), "--verbose"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    mended = "1 gap bridged, 1 track split at a long gap, 1 single sample dropped"
    helps = (
        f"the longest last {', '.join(['29.6'] * 4)} s; --set"
        " resample.min_duration_s=17.6"
    )
    for text in (
        "walks.csv: positions in mm, as --unit says; converted to m",
        f"walks: {mended} and 22 tracks too short for a scene",
        f"5 usable tracks: too few to decide anything ({helps} takes 20 or more)",
    ):
        assert text in said
        for name in ("tables.txt", "report.html"):
            assert text in " ".join((out / name).read_text(encoding="utf-8").split())
    words += ["--set", "resample.min_duration_s=17.6", "--fresh", "--dry-run"]
    assert matrix.main([*map(str, words)]) == 0
    assert "walks: 25 of 27 tracks used" in capsys.readouterr().err
