"""Tables of tracks: the rows of a run's summary, each in its place."""

import pytest
import tracking_tables

HEADS = (
    "dataset,mechanism,level,consumer,knowledge,metric,value,ci_low,ci_high,unit,family,"
    "policy"
)
FRACTION = "0.41,0.38,0.44,fraction"
NEAR = '"tracks:gnn,policy=near:3,window_s=2"'
ROWS = f"""\
run,raw,,log,oracle,known_share,{FRACTION},raw,tracks:gnn
run,raw,,tracker,,id_switches,238.6,225.1,250.7,1/min,raw,tracks:gnn
run,raw,,tracker,,id_switches,0,0,0,1/min,raw,tracks:oracle
run,raw,,log,oracle,known_share,{FRACTION},raw,"tracks:gnn,noise=before"
run,fid:1,1.0,log,oracle,known_share,0.1,,,fraction,fid,"tracks:gnn,noise=before"
run,fid:1,1.0,log,oracle,known_share,0.2,,,fraction,fid,detections:gnn
run,raw,,kalman_cv,,missed_future_rate,0.9,0.8,1,fraction,raw,tracks:gnn
run:horizon=3s,raw,,kalman_cv,,missed_future_rate,0.5,0.4,0.6,fraction,raw,tracks:gnn
run,raw,,log,oracle,known_share,0.7,0.6,0.8,fraction,raw,everything
run,raw,,shared,,disclosed_share,0.3,0.2,0.4,fraction,raw,{NEAR}
run,raw,,log,oracle,known_share,0.25,0.2,0.3,fraction,raw,{NEAR}
run,raw,,h-1s/kinematic,informed,rank1,0.6,0.5,0.7,fraction,raw,tracks:gnn
run,raw,,h-1s/kinematic,blind,rank1,0.55,0.5,0.7,fraction,raw,tracks:gnn
run,raw,,h-1s/control-random,,rank1,0.04,0.0,0.1,fraction,raw,tracks:gnn
run,raw,,h-1s/control-random,,linkable_share,0.8,0.7,0.9,fraction,raw,tracks:gnn
"""


def read_tables(text):
    """The rows of each table, by heads."""
    tables = []
    for block in text.strip().split("\n\n")[1:]:
        heads, _, *rows = (
            [cell.strip() for cell in line.strip("|").split("|")]
            for line in block.splitlines()
        )
        tables.append([dict(zip(heads, row, strict=True)) for row in rows])
    return tables


@pytest.fixture
def tables(tmp_path, capsys):
    path = tmp_path / "summary.csv"
    path.write_text(f"{HEADS}\n{ROWS}", encoding="utf-8")
    assert tracking_tables.main([f"A run={tmp_path}"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("## A run\n\n|")
    return read_tables(text)


def test_each_number_stands_in_its_row_and_column(tables):
    oracle, gnn, noisy, detections = tables[0]
    assert oracle["switches a min"] == "0"
    assert gnn["tracker"] == "`gnn`"
    assert gnn["known, %"] == "41 [38, 44]"
    assert gnn["switches a min"] == "239 [225, 251]"
    assert gnn["robot misses, %"] == "50 [40, 60]"
    assert (noisy["noise"], noisy["added"]) == ("fid:1", "before")
    assert (noisy["known, %"], noisy["GOSPA, m"]) == ("10", "")
    assert (detections["added"], detections["known, %"]) == ("detections", "20")


def test_policies_and_linkers_have_tables_of_their_own(tables):
    (answered,), (linked,) = tables[1:]
    assert answered["policy"] == "`near:3,window_s=2`"
    assert answered["disclosed, %"] == "30 [20, 40]"
    assert answered["known, %"] == "25 [20, 30]"
    assert linked["task"] == "h-1s"
    assert linked["`kinematic`, %"] == "60 [50, 70]"
    assert linked["random scores, %"] == "4 [0, 10]"
    assert linked["linkable, %"] == "80 [70, 90]"


def test_a_folder_without_a_run_is_named(tmp_path, capsys):
    assert tracking_tables.main([f"A run={tmp_path}"]) == 2
    assert str(tmp_path) in capsys.readouterr().err
