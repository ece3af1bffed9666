"""Tables of tracks: the rows of a run's summary, each in its place."""

import tracking_tables

HEADS = (
    "dataset,mechanism,level,consumer,metric,value,ci_low,ci_high,unit,family,policy"
)
FRACTION = "0.41,0.38,0.44,fraction"
ROWS = f"""\
run,raw,,log,known_share,{FRACTION},raw,tracks:gnn
run,raw,,tracker,id_switches,238.6,225.1,250.7,1/min,raw,tracks:gnn
run,raw,,tracker,id_switches,0,0,0,1/min,raw,tracks:oracle
run,raw,,log,known_share,{FRACTION},raw,"tracks:gnn,noise=before"
run,fid:1,1.0,log,known_share,0.1,,,fraction,fid,"tracks:gnn,noise=before"
run,raw,,kalman_cv,missed_future_rate,0.9,0.8,1,fraction,raw,tracks:gnn
run:horizon=3s,raw,,kalman_cv,missed_future_rate,0.5,0.4,0.6,fraction,raw,tracks:gnn
run,raw,,log,known_share,0.7,0.6,0.8,fraction,raw,everything
"""


def test_each_number_stands_in_its_row_and_column(tmp_path, capsys):
    path = tmp_path / "summary.csv"
    path.write_text(f"{HEADS}\n{ROWS}", encoding="utf-8")
    assert tracking_tables.main([f"A run={tmp_path}"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "## A run"
    heads, *rows = (
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in (lines[2], *lines[4:-1])
    )
    oracle, gnn, noisy = (dict(zip(heads, row, strict=True)) for row in rows)
    assert oracle["switches a min"] == "0"
    assert gnn["tracker"] == "`gnn`"
    assert gnn["known, %"] == "41 [38, 44]"
    assert gnn["switches a min"] == "239 [225, 251]"
    assert gnn["robot misses, %"] == "50 [40, 60]"
    assert (noisy["noise"], noisy["added"]) == ("fid:1", "before")
    assert (noisy["known, %"], noisy["GOSPA, m"]) == ("10", "")


def test_a_folder_without_a_run_is_named(tmp_path, capsys):
    assert tracking_tables.main([f"A run={tmp_path}"]) == 2
    assert str(tmp_path) in capsys.readouterr().err
