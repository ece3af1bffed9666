"""The command: its words, its exit codes, its files."""

import re

import pandas as pd
import pytest
from helpers import commands
from helpers.commands import assert_refused
from helpers.small_runs import write_walks

from evaluation import matrix
from evaluation.plan.axes import expand_axes
from evaluation.plan.plan import _changed_reading_options
from evaluation.plan.presets import DEFAULT, DISSOCIATION, PRESETS, PROTECTIONS
from evaluation.plan.settings import Settings
from evaluation.store.csv_files import to_csv
from isac_track import plugins

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture
def small(csv_recording, tmp_path):
    words = "--scenes 8 --mechanism raw --predictor none --attack none"
    words += " --policy none --out"
    return ["--dataset", csv_recording, *words.split(), tmp_path / "run"]


def test_a_dry_run_writes_nothing_and_a_run_ends_in_a_table(small, tmp_path, ran):
    assert "1 cells" in ran(matrix, *small, "--dry-run").err
    assert not (tmp_path / "run").exists()
    shown = ran(matrix, *small)
    assert shown.code == 0
    assert "known to 0.3 m, %" in shown.out
    assert f"Tables: {tmp_path / 'run' / 'tables.txt'}" in shown.out
    assert "12 of 12 tracks used, 8 scenes; 1 cells" in shown.err
    value = pd.read_csv(tmp_path / "run" / "summary.csv").set_index("metric")["value"][
        "plr"
    ]
    assert f" {100 * value:.0f} " in shown.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "smok"], "unknown preset 'smok'; did you mean 'smoke'?"),
        (["--scenes", "many"], "argument --scenes: invalid int value: 'many'"),
        (
            ["--scenes", "1"],
            "at least 2 scenes (one of each label) and at most 10,000,000, got 1",
        ),
        (["--seed", "-1"], "the seed must not be negative"),
        (["--jobs", "0"], "jobs must be at least 1"),
        (["--fps", "25"], "--fps describes your own file: name it with --dataset PATH"),
        (
            ["--format", "csv"],
            "--format describes your own file: name it with --dataset PATH",
        ),
        (["--dataset", "stuednts03"], "did you mean students03?"),
        (["--mechanism", "fdi:1"], "did you mean 'fid'?"),
        (["--mechanism", "none"], "the mechanism axis is empty; name one"),
        (["--mechanism", "none", "--mechanism", "raw"], "none empties the axis"),
        (["--set", "privacy.epsilon_m"], "--set takes STAGE.KEY=VALUE"),
        (["--config", "nowhere.toml"], "--config nowhere.toml: No such file"),
        (["--verbos"], "unrecognized arguments: --verbos"),
        (["--pre", "smoke"], "unrecognized arguments: --pre smoke"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    arguments, message, ran, monkeypatch
):
    monkeypatch.delenv("ISAC_TRACK_DATA", raising=False)
    assert_refused(ran(matrix, "--dry-run", *arguments), message)


def test_a_backend_that_matplotlib_does_not_know_is_said_before_anything_is_printed(
    tmp_path,
):
    words = ("-m", "evaluation.report", "--pdf", "nowhere")
    ended = commands.run(tmp_path, *words, changed={"MPLBACKEND": "nonsense"})
    assert_refused(ended, "no backend 'nonsense'; unset MPLBACKEND")
    assert len(ended.err.splitlines()) == 1


def test_a_name_that_a_spreadsheet_would_run_is_text_in_every_table(
    small, csv_recording, tmp_path, ran
):
    named = csv_recording.rename(tmp_path / "=cmd.csv")
    assert ran(matrix, "--dataset", named, *small[2:]).code == 0
    tables = [path.read_text() for path in (tmp_path / "run").rglob("*.csv")]
    assert any("'=cmd" in table for table in tables)
    cells = [
        cell
        for table in tables
        for line in table.splitlines()
        for cell in line.split(",")
    ]
    assert not any(cell.startswith("=") for cell in cells)


def test_numbers_among_names_stay_numbers():
    assert (
        to_csv(pd.DataFrame({"level": ["-0.5", "-1+1", "+x", "a", None]}))
        == b"level\n-0.5\n'-1+1\n'+x\na\n\"\"\n"
    )


def test_an_interruption_is_exit_code_130_and_says_how_to_continue(
    small, ran, monkeypatch
):
    def interrupt(_settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(matrix, "settings_from", interrupt)
    ended = ran(matrix, *small)
    assert ended.code == 130
    assert "the same command continues" in ended.err


def parse_settings(*arguments):
    return matrix.settings_from(
        matrix.parser().parse_args([str(argument) for argument in arguments])
    )


def test_options_become_settings():
    words = (
        "--preset=full --seed=3 --jobs=2 --mechanism=raw --mechanism=fid:1"
        " --predictor=none"
    )
    words += " --dataset=walks.txt --format=obsmat --fps=25"
    settings = parse_settings(*words.split(), "--set=privacy.epsilon_m=0.5", "--fresh")
    assert (settings.dataset, settings.format, settings.fps) == (
        "walks.txt",
        "obsmat",
        25.0,
    )
    assert settings.mechanisms == ("raw", "fid:1")
    assert settings.predictors == ()
    assert settings.n_attacked_scenes == 5000
    assert settings.stages.privacy.epsilon_m == 0.5
    assert (settings.seed, settings.jobs, settings.fresh) == (3, 2, True)
    assert parse_settings() == Settings()


def test_a_file_gives_the_same_keys_and_the_command_line_wins(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(
        'preset = "smoke"\nseed = 5\nscenes = 30\nmechanism = ["raw",'
        ' "fid:1"]\npredictor = "least_squares"\n[privacy]\nepsilon_m ='
        ' 0.4\n[sensing]\nlaw = "isotropic"\n',
        encoding="utf-8-sig",  # some editors put a mark in front
    )
    settings = parse_settings(
        "--config", path, "--seed", "7", "--set", "privacy.epsilon_m=0.2"
    )
    assert (settings.preset, settings.seed, settings.n_attacked_scenes) == (
        "smoke",
        7,
        30,
    )
    assert settings.mechanisms == ("raw", "fid:1")
    assert settings.predictors == ("least_squares",)
    stages = {"privacy.epsilon_m": 0.2, "sensing.law": "isotropic"}
    assert settings.stages == Settings().stages.changed(stages)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("presett = 'smoke'", "unknown key 'presett'"),
        ("seed = 'one'", "run.toml: argument --seed: invalid int value: 'one'"),
        ("seed = true", "argument --seed: invalid int value: 'True'"),
        ("mechanism = 3", "unknown mechanism '3'"),
        ("preset = 3", "unknown preset '3'; known: quick, smoke, paper"),
        (
            "dataset = 'x.csv'\nfps = 'fast'",
            "argument --fps: invalid float value: 'fast'",
        ),
        ("[privacy]\nepsilon = 1", "unknown setting 'privacy.epsilon'"),
        ("seed = = 1", "Invalid value"),
    ],
)
def test_a_wrong_file_names_itself_and_the_key(tmp_path, ran, text, message):
    path = tmp_path / "run.toml"
    path.write_text(text, encoding="utf-8")
    ended = ran(matrix, "--config", path, "--dry-run")
    assert_refused(ended, message)
    assert len(ended.err.splitlines()) == 1


def test_the_default_is_a_preset_of_few_levels_with_at_least_one_of_each_kind():
    crossed = expand_axes(Settings())
    assert Settings().preset == DEFAULT == "quick"
    assert (Settings().n_attacked_scenes, Settings().n_all_scenes) == (250, 2000)
    by_world = crossed.scenes.mechanisms_by_world
    assert by_world == dict.fromkeys(by_world, ())
    families = {plugin.spec.partition(":")[0] for plugin in crossed.mechanisms}
    assert families == {"raw", "fid", "fixed", "ou"}
    assert {plugin.adding for plugin in crossed.mechanisms} == {
        "",
        "linear",
        "independent",
    }
    assert crossed.scenes.utility_predictors == crossed.scenes.predictors
    assert [task.name for task in crossed.linkage.tasks] == [
        "rerelease",
        "handover-1s",
        "handover-5s",
    ]
    linkage = crossed.linkage
    assert all(len(linkage.consumers(task)) > 2 for task in linkage.tasks)


def test_a_folder_of_another_preset_is_refused_in_one_line(tmp_path, ran):
    out = tmp_path / "run"
    walks = write_walks(tmp_path / "walks.csv")
    few = ["--scenes", "8", "--mechanism", "raw", "--task", "none", "--dataset", walks]
    few += ["--attack", "none", "--predictor", "least_squares"]
    assert (
        ran(matrix, "--preset", "smoke", *few, "--out", out, "--no-pictures").code == 0
    )
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    ended = ran(matrix, *few, "--out", out)
    assert_refused(
        ended, f"{out} holds a run of --preset smoke, not of quick; use --fresh"
    )
    assert len(ended.err.splitlines()[-1:]) == 1
    assert {path: path.read_bytes() for path in before} == before


def test_the_presets_are_those_of_the_design():
    assert PRESETS["smoke"].scenes == 40
    assert len(expand_axes(Settings(preset="smoke")).mechanisms) == 5
    assert PRESETS["paper"].scenes == 500
    paper = expand_axes(Settings(preset="paper")).mechanisms
    assert len(paper) == 1 + 2 * (13 + 10) + len(DISSOCIATION) + len(PROTECTIONS)
    etas = [plugin.level for plugin in paper if plugin.name == "fid"]
    assert etas[0] == 1.0
    assert etas[9:] == [1e3, 1e4, 1e5, 1e6]
    errors = [
        plugin.level for plugin in paper if plugin.name == "fixed:adding=independent"
    ]
    assert errors == pytest.approx([step / 10 for step in range(1, 11)], abs=1e-12)
    assert PRESETS["full"].scenes == 5000
    frontier = expand_axes(Settings(preset="frontier")).scenes
    assert frontier.utility_predictors == frontier.predictors  # all scenes, each robot


def test_list_names_everything_that_can_be_named(ran):
    shown = ran(matrix, "--list").out
    for kind in ("mechanisms", "predictors"):
        assert all(name in shown for name in plugins.names(kind))
    assert all(name in shown for name in PRESETS)
    assert "students03" in shown
    assert "privacy.epsilon_m" in shown


@pytest.mark.parametrize("option", ["--help", "--list"])
def test_help_and_list_import_nothing_heavy(option, tmp_path):
    script = f"""import contextlib, sys
from evaluation import matrix
with contextlib.suppress(SystemExit):
    matrix.main([{option!r}])
heavy = {{'pandas', 'scipy', 'matplotlib', 'pyarrow', 'sklearn', 'numba'}}
sys.exit(str(heavy & sys.modules.keys()) if heavy & sys.modules.keys() else 0)"""
    ended = commands.run(tmp_path, "-c", script)
    assert ended.code == 0, ended


def test_the_default_falls_back_to_the_simulated_crowd_and_says_so(
    tmp_path, ran, monkeypatch
):
    monkeypatch.delenv("ISAC_TRACK_DATA", raising=False)
    monkeypatch.setenv("ISAC_TRACK_CACHE", str(tmp_path / "empty"))
    out = tmp_path / "run"
    words = "--preset smoke --scenes 8 --mechanism raw --task none"
    shown = ran(matrix, *words.split(), "--out", out)
    assert shown.code == 0
    assert "notice: students03 is not here" in shown.err
    assert "plaza" in shown.out
    assert "plaza" in (out / "manifest.json").read_text(encoding="utf-8")
    assert set(pd.read_csv(out / "summary.csv")["dataset"]) == {
        "plaza",
        "plaza:horizon=3s",
    }


def test_what_a_reader_must_know_is_a_notice(csv_recording, tmp_path, ran):
    words = (
        "--scenes 8 --mechanism raw --task none --predictor kalman_cv:noise=declared"
    )
    words += " --set scenes.clearance_m=6.5 --set scenes.max_redraws=2"
    words += " --set conflict.horizons_s=none"
    shown = ran(
        matrix, "--dataset", csv_recording, *words.split(), "--out", tmp_path / "run"
    )
    assert (
        "kalman_cv:noise=declared asked for SIGMA, which a robot does not have"
        in shown.err
    )
    assert "2 notices in full: tables.txt" in shown.err
    doubts = " ".join(shown.out.partition("Doubts: ")[2].split())
    message = "12 usable tracks: too few to decide anything; 2 more in tables.txt. "
    assert doubts.startswith(message)
    message = (tmp_path / "run" / "tables.txt").read_text(encoding="utf-8")
    assert re.search(r"\d+ background agents keep their last draw", message)


def test_what_is_said_of_a_file_is_the_same_from_a_config_and_in_the_identity(tmp_path):
    (tmp_path / "c.toml").write_text(f"""dataset = {str(tmp_path / "f.csv")!r}
columns = "t=time[ms],x=px[cm]"
on_duplicate = "mean"
crs = "degrees"
drop_frozen = 3
""")
    typed = parse_settings(
        "--dataset",
        tmp_path / "f.csv",
        "--columns",
        "t=time[ms],x=px[cm]",
        "--on-duplicate",
        "mean",
        "--crs",
        "degrees",
        "--drop-frozen",
        3,
    )
    assert parse_settings("--config", tmp_path / "c.toml") == typed
    expected = {
        "columns": "t=time[ms],x=px[cm]",
        "on_duplicate": "mean",
        "crs": "degrees",
    }
    assert _changed_reading_options(typed) == {**expected, "drop_frozen": 3.0}
    assert _changed_reading_options(parse_settings()) == {}
