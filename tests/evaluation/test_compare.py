"""Two runs side by side: what changed, which numbers differ, and how sure that is."""

import io
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.runs import rows_of
from helpers.small_runs import write_walks
from helpers.summaries import edit_manifest
from rich.console import Console
from scipy.stats import t as student

import evaluation
from evaluation import compare
from evaluation.analysis import summary
from evaluation.analysis.differences import COLUMNS
from evaluation.analysis.differences import compare as compared
from evaluation.analysis.metrics import HEADLINE_METRICS
from evaluation.analysis.significance import holm
from evaluation.reporting.difference_tables import show
from evaluation.runs.manifest import read_manifest, write_manifest
from isac_track.config import StageSettings
from isac_track.errors import DataError, SettingsError

KEY = ["mechanism", "level", "consumer", "knowledge", "metric"]
MECHANISMS = (
    "raw",
    "fid:1",
    *(f"fixed:{level}{rule}" for rule in ("", ",adding=independent") for level in ("0.7", "1")),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compare")


@pytest.fixture(scope="module")
def settings(folder):
    return evaluation.Settings(
        preset="smoke",
        dataset=str(write_walks(folder / "walks.csv")),
        scenes=20,
        mechanisms=MECHANISMS,
        predictors=("least_squares",),
        attacks=("kalman_rts", "shape"),
        tasks=("rerelease",),
        out=folder / "base",
        jobs=1,
    )


def run(settings, name, **changes):
    return evaluation.run(
        replace(settings, out=settings.out.with_name(name), **changes), pictures=False
    ).out


@pytest.fixture(scope="module")
def base(settings):
    return run(settings, "base")


@pytest.fixture(scope="module")
def again(base):
    out = shutil.copytree(base, base.with_name("again"))
    edit_manifest(out, lambda manifest: manifest.update(wall_time_s=1e3, dropped_cells=7))
    return out


@pytest.fixture(scope="module")
def wide(settings):
    return run(settings, "wide", stages=StageSettings().changed({"privacy.epsilon_m": 0.5}))


@pytest.fixture(scope="module")
def reseeded(settings):
    return run(settings, "reseeded", seed=1)


@pytest.fixture(scope="module")
def others(settings, folder):
    path = write_walks(folder / "others.csv", n_people=24, seed=7)
    return run(settings, "others", dataset=str(path))


@pytest.fixture(scope="module")
def narrow(settings):
    return run(settings, "narrow", mechanisms=("raw",), predictors=(), attacks=(), tasks=())


def numbers(out):
    """The rows of a run's summary that have a value, by key."""
    frame = pd.read_csv(out / "summary.csv", keep_default_na=True)
    frame["knowledge"] = frame["knowledge"].fillna("")
    return frame.dropna(subset=["value"]).set_index(KEY)


def by_key(comparison):
    names = {"mechanism_a": "mechanism", "level_a": "level"}
    return comparison.rows.rename(columns=names).set_index(KEY)


def row_of(comparison, *, metric="plr", mechanism="fixed", level=0.7, consumer="shared"):
    rows = comparison.rows
    (found,) = rows[
        (rows["mechanism_a"] == mechanism)
        & (rows["level_a"] == level)
        & (rows["consumer"] == consumer)
        & (rows["metric"] == metric)
    ].to_dict("records")
    return found


def plr_replicates(out, *, weights, groups=None, spec="fixed:0.7"):
    """PLR as shared and its replicates, straight from the cells."""
    manifest = read_manifest(out)
    rows = rows_of(out, spec, "shared")
    by_group = rows.groupby("group", observed=True)["plr"].agg(["sum", "count"])
    by_group = by_group.reindex(groups or manifest["groups"]).fillna(0.0)
    value = by_group["sum"].sum() / by_group["count"].sum()
    return value, (weights @ by_group["sum"]) / (weights @ by_group["count"])


def tree(out):
    return {path: path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def shown(comparison, *, width=116, every=False):
    raw = io.StringIO()
    show(comparison, every=every, console=Console(file=raw, width=width, highlight=False))
    return raw.getvalue()


class TestTheSameSettings:
    def test_every_number_is_identical(self, base, again):
        found = compared(base, again)
        assert set(found.rows["finding"]) == {"identical"}
        assert (found.rows["pairing"] == "people and draws").all()
        assert (found.rows[["difference", "ci_low", "ci_high"]] == 0.0).all(axis=None)

    def test_nothing_changed_and_the_text_says_so(self, base, again, capsys):
        found = compared(base, again)
        assert not any(found.changed.values())
        assert found.only == {}
        text = shown(found)
        assert "Nothing changed in data, settings, code and libraries." in text
        assert f"{len(found.rows)} of {len(found.rows)} numbers are identical" in text
        assert compare.main([str(base), str(again), "--fail-on-change"]) == 0
        assert capsys.readouterr().err == ""


class TestAnotherRadius:
    def test_the_setting_is_all_that_changed(self, base, wide):
        found = compared(base, wide)
        assert found.changed == {
            "data": {},
            "settings": {"privacy.epsilon_m": (0.3, 0.5)},
            "code": {},
        }
        assert "privacy.epsilon_m  0.3 -> 0.5" in shown(found)

    def test_differences_are_those_of_the_summaries(self, base, wide):
        found, a, b = by_key(compared(base, wide)), numbers(base), numbers(wide)
        assert len(found) == len(a)
        for name, column in (("a", a), ("b", b)):
            pd.testing.assert_series_equal(
                found[name].sort_index(), column["value"].sort_index(), check_names=False
            )
        pd.testing.assert_series_equal(
            found["difference"].sort_index(),
            (b["value"] - a["value"]).sort_index(),
            check_names=False,
        )

    def test_only_what_the_radius_defines_moves(self, base, wide):
        rows = compared(base, wide).rows
        moved = rows[rows["finding"] != "identical"]
        assert set(moved["metric"]) <= {"plr", "ael", "mel", "plr_over_benchmark"}
        assert {"plr", "ael", "mel"} <= set(moved["metric"])
        assert (rows["pairing"] == "people and draws").all()

    @pytest.mark.parametrize("other", ["wide", "reseeded"])
    def test_the_interval_is_that_of_the_same_people_drawn_for_both(self, base, other, request):
        runs = base, request.getfixturevalue(other)
        weights = summary.weights_of(read_manifest(base))
        (a, drawn_a), (b, drawn_b) = (plr_replicates(out, weights=weights) for out in runs)
        row = row_of(compared(*runs))
        assert row["difference"] == pytest.approx(b - a, abs=1e-12)
        ends = np.quantile(drawn_b - drawn_a, [0.025, 0.975])
        assert [row["ci_low"], row["ci_high"]] == pytest.approx(ends, abs=1e-12)
        error = (drawn_b - drawn_a).std(ddof=1)
        assert row["t"] == pytest.approx((b - a) / error)
        assert row["p_value"] == pytest.approx(2 * student.sf(abs(b - a) / error, df=row["n"] - 1))

    def test_holm_runs_over_either_family(self, base, wide):
        rows = compared(base, wide).rows
        assert set(rows.loc[rows["headline"], "metric"]) <= set(HEADLINE_METRICS)
        for _, family in rows.groupby("headline"):
            adjusted = holm(family["p_value"].to_numpy())
            assert family["p_holm"].to_numpy() == pytest.approx(adjusted, nan_ok=True)
        tested = rows[(rows["finding"] != "identical") & rows["p_holm"].notna()]
        assert ((tested["finding"] == "differs") == (tested["p_holm"] <= 0.05)).all()
        assert (rows["finding"] == "differs").any()

    def test_the_surest_come_first(self, base, wide):
        p_values = compared(base, wide).rows["p_value"].dropna()
        assert p_values.is_monotonic_increasing

    def test_a_control_is_not_of_the_headline(self, base, wide):
        rows = compared(base, wide).rows
        controls = rows["consumer"].str.contains("/control-")
        assert controls.any()
        assert not rows.loc[controls, "headline"].any()
        assert rows.loc[~controls & (rows["metric"] == "rank1"), "headline"].all()

    def test_the_gate_is_shut(self, base, wide, capsys):
        assert compare.main([str(base), str(wide), "--fail-on-change"]) == 1
        assert compare.main([str(base), str(wide)]) == 0
        assert "PLR %" in capsys.readouterr().out


class TestAnotherSeed:
    def test_no_headline_number_differs(self, base, reseeded):
        # Of one population: a false "differs" has a chance of at most 5 %, and the seeds are fixed.
        rows = compared(base, reseeded).rows
        assert not (rows.loc[rows["headline"], "finding"] == "differs").any()

    def test_the_text_says_what_is_paired(self, base, reseeded):
        text = shown(compared(base, reseeded), width=300)
        assert re.search(r"seed +0 -> 1", text)
        assert "paired over people, not over draws" in text
        assert "not paired: intervals as of independent estimates" in text


class TestDraws:
    @pytest.mark.parametrize(
        ("name", "value", "scenes", "linkage"),
        [
            ("privacy.epsilon_m", 0.1, "people and draws", "people and draws"),
            ("sensing.power_dbm", 20.0, "people and draws", "people and draws"),
            ("conflict.decision", "probability", "people and draws", "people and draws"),
            ("linkage.window_s", 9.0, "people and draws", "none"),
            ("sensing.n_paths", 9, "people", "people"),
            ("sensing.law", "isotropic", "people", "people"),
            ("conflict.safety_radius_m", 0.5, "people", "people and draws"),
            ("scenes.agents", 3, "people", "people and draws"),
            ("scenes", 19, "people", "people and draws"),
            ("resample.rate_max_hz", 20.0, "people", "people"),
            ("crowd", "0", "people and draws", "none"),
            ("seed", 9, "people", "none"),
            ("sha256", "0", "none", "none"),
            # An earlier version of the code may have chosen others.
            ("people", 1, "people and draws", "none"),
        ],
    )
    def test_a_setting_pairs_scenes_and_linkage(self, base, tmp_path, name, value, scenes, linkage):
        shutil.copytree(base, tmp_path / "b")
        manifest = read_manifest(base)
        task = manifest["linkage"]["tasks"]["rerelease"]
        changed = task if name == "people" else manifest["identity"]
        assert name in changed
        changed[name] = value
        write_manifest(tmp_path / "b", manifest)
        rows = compared(base, tmp_path / "b").rows
        linked = rows["consumer"].str.startswith("rerelease/")
        assert set(rows.loc[~linked, "pairing"]) == {scenes}
        assert set(rows.loc[linked, "pairing"]) == {linkage}


class TestOtherPeople:
    def test_nothing_is_paired_and_the_data_changed(self, base, others):
        found = compared(base, others)
        assert set(found.rows["pairing"]) == {"none"}
        assert {"sha256", "tracks", "tracks_used"} <= found.changed["data"].keys()
        assert re.search(r"tracks_used +30 -> 24", shown(found))

    def test_intervals_combine_those_of_either_run(self, base, others):
        found, a, b = by_key(compared(base, others)), numbers(base), numbers(others)
        row = found.loc[("fixed", 0.7, "shared", "", "plr")]
        one, two = (frame.loc[("fixed", 0.7, "shared", "", "plr")] for frame in (a, b))
        value = two["value"] - one["value"]
        low = value - np.hypot(two["value"] - two["ci_low"], one["ci_high"] - one["value"])
        high = value + np.hypot(two["ci_high"] - two["value"], one["value"] - one["ci_low"])
        assert [row["difference"], row["ci_low"], row["ci_high"]] == pytest.approx(
            [value, low, high], abs=1e-12
        )

    def test_who_is_in_both_runs_is_drawn_alike(self, settings, base):
        stages = StageSettings().changed({"resample.min_duration_s": 28.0})
        axes = {"mechanisms": ("fixed:0.7",), "predictors": (), "attacks": (), "tasks": ()}
        longer = run(settings, "longer", stages=stages, **axes)
        everybody = read_manifest(base)["groups"]
        assert len(everybody) == 30
        assert len(read_manifest(longer)["groups"]) == 20
        weights = summary.weights_of(read_manifest(base))
        (a, drawn_a), (b, drawn_b) = (
            plr_replicates(out, weights=weights, groups=everybody) for out in (base, longer)
        )
        for first, second, sign in ((base, longer, 1), (longer, base, -1)):
            row = row_of(compared(first, second))
            assert row["pairing"] == "people"
            ends = sign * np.quantile(drawn_b - drawn_a, [0.025, 0.975])[::sign]
            assert row["difference"] == pytest.approx(sign * (b - a), abs=1e-12)
            assert [row["ci_low"], row["ci_high"]] == pytest.approx(ends, abs=1e-12)


class TestMechanisms:
    def test_two_rules_of_one_run_meet_at_every_level(self, base):
        found = compared(base, base, mechanism_a="fixed", mechanism_b="fixed:adding=independent")
        assert set(found.rows["mechanism_b"]) == {"fixed:adding=independent"}
        assert (found.rows["level_a"] == found.rows["level_b"]).all()
        assert set(found.rows["level_a"]) == {0.7, 1.0}
        of = numbers(base)["value"]
        for row in found.rows.to_dict("records"):
            where = row["level_a"], row["consumer"], row["knowledge"], row["metric"]
            assert row["a"] == pytest.approx(of[("fixed", *where)])
            assert row["b"] == pytest.approx(of[("fixed:adding=independent", *where)])
        assert (found.rows["pairing"] == "people and draws").all()

    def test_single_levels_meet_whatever_they_are(self, base):
        found = compared(base, base, mechanism_a="raw", mechanism_b="fixed:1")
        of = numbers(base)["value"]
        (plr,) = found.rows[
            (found.rows["consumer"] == "shared") & (found.rows["metric"] == "plr")
        ].to_dict("records")
        fixed = of[("fixed", 1.0, "shared", "", "plr")]
        assert plr["b"] == pytest.approx(fixed)
        assert plr["difference"] < 0  # noise hides
        assert "raw -> fixed 1" in shown(found)

    def test_runs_of_other_people_may_be_crossed_too(self, base, others):
        found = compared(base, others, mechanism_a="fixed:1", mechanism_b="fixed:0.7")
        assert set(found.rows["pairing"]) == {"none"}
        assert set(found.rows["level_b"]) == {0.7}

    def test_the_command_takes_one_folder(self, base, capsys):
        words = ["--mechanism-a", "fixed", "--mechanism-b", "fixed:adding=independent"]
        assert compare.main([str(base), *words]) == 0
        assert "fixed -> fixed:adding=independent" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("a", "b", "error", "message"),
        [
            ("fixde", "fixed", SettingsError, r"--mechanism-a fixde: .*it has .*fixed"),
            ("fixed", "fixed:0.3", SettingsError, r"--mechanism-b fixed:0\.3: .*no such mechanism"),
            ("fixed", None, SettingsError, r"--mechanism-a and --mechanism-b are named together"),
            ("raw", "fixed", DataError, r"no level and consumer in common"),
            ("fixed", "fid", SettingsError, r"fixed and fid are not the same quantity"),
        ],
    )
    def test_what_does_not_fit_is_refused_with_the_way_out(self, base, a, b, error, message):
        with pytest.raises(error, match=message):
            compared(base, base, mechanism_a=a, mechanism_b=b)


class TestOtherAxes:
    def test_what_only_one_run_has_is_named_and_counted(self, base, narrow):
        found = compared(base, narrow)
        assert found.only == {
            "mechanisms": ([*MECHANISMS[1:], "clean"], []),
            "predictors": (["least_squares"], []),
            "attacks": (["kalman_rts", "shape"], []),
            "tasks": (["rerelease"], []),
        }
        assert set(found.rows["finding"]) == {"identical"}
        n_a, n_b = (len(pd.read_csv(out / "summary.csv")) for out in (base, narrow))
        assert found.only_numbers == (n_a - n_b, 0)
        assert "predictors only in A: least_squares" in shown(found)

    def test_runs_that_share_nothing_are_refused(self, settings, narrow, capsys):
        apart = run(
            settings, "apart", mechanisms=("fixed:0.3",), predictors=(), attacks=(), tasks=()
        )
        assert compare.main([str(narrow), str(apart)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "share no number: A has raw, B has fixed" in line


class TestCommand:
    def test_the_table_is_tidy(self, base, wide, tmp_path, capsys):
        path = tmp_path / "table.csv"
        assert compare.main([str(base), str(wide), "--csv", str(path)]) == 0
        table = pd.read_csv(path)
        assert list(table.columns) == COLUMNS
        rows = compared(base, wide).rows
        assert len(table) == len(rows)
        assert table["difference"].to_numpy() == pytest.approx(rows["difference"], nan_ok=True)
        assert "identical" in capsys.readouterr().out

    def test_json_is_one_object_and_nothing_is_written_into_the_runs(self, base, wide, capsys):
        before = [tree(out) for out in (base, wide)]
        assert compare.main([str(base), str(wide), "--json"]) == 0
        assert [tree(out) for out in (base, wide)] == before
        found = json.loads(capsys.readouterr().out)
        assert found["changed"]["settings"] == {"privacy.epsilon_m": {"a": 0.3, "b": 0.5}}
        rows = compared(base, wide).rows
        headline = rows[rows["headline"]]
        assert len(found["differences"]) == len(headline)
        assert found["numbers"]["in_both"] == len(rows)
        counts = found["numbers"]["headline"]
        assert counts["differs"] == (headline["finding"] == "differs").sum()
        assert sum(counts.values()) == len(headline)
        assert compare.main([str(base), str(wide), "--json", "--all"]) == 0
        assert len(json.loads(capsys.readouterr().out)["differences"]) == len(rows)

    def test_a_heading_that_is_too_long_loses_its_middle(self, base, wide):
        found = compared(base, wide)
        found.rows["consumer"] = found.rows["consumer"] + "@" + "x" * 90
        lines = shown(found, width=80, every=True).splitlines()
        assert max(map(len, lines)) <= 80
        assert any("..." in line and line.endswith("fixed:adding=independent") for line in lines)

    def test_the_default_shows_the_surest_of_the_headline(self, base, reseeded):
        found = compared(base, reseeded)
        some, every = shown(found), shown(found, every=True)
        assert "The 20 surest of" in some
        assert "AUC" not in some
        assert "AUC" in every

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (["--nonsense"], ""),
            ([], ""),
            (["{base}"], ""),
            (["{base}", "/nowhere/at/all"], "/nowhere/at/all holds no run"),
            (["{base}", "{csv}"], ""),
            (["{base}", "{base}", "--csv", "/no/table.csv"], "cannot write /no/table.csv"),
        ],
    )
    def test_wrong_usage_ends_in_one_line(self, base, settings, words, said, capsys):
        words = [word.format(base=base, csv=settings.dataset) for word in words]
        assert compare.main(words) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("error: ")
        assert said in line

    def test_a_reader_who_leaves_early_sees_no_traceback(self, base, wide):
        words = [sys.executable, "-m", "evaluation.compare", base, wide, "--json", "--all"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            process.stdout.read(10)
            process.stdout.close()
            assert process.stderr.read() == b""
        assert process.returncode == 141

    def test_a_manifest_of_another_version_is_named(self, base, narrow, tmp_path, capsys):
        shutil.copytree(narrow, tmp_path / "old")
        manifest = json.loads((tmp_path / "old" / "manifest.json").read_text())
        del manifest["groups"]
        (tmp_path / "old" / "manifest.json").write_text(json.dumps(manifest))
        assert compare.main([str(base), str(tmp_path / "old")]) == 2
        assert f"{tmp_path / 'old'} was written by another version" in capsys.readouterr().err

    def test_a_gate_that_nothing_can_fail_is_refused(self, settings, folder, capsys):
        # The group column makes one cluster of everybody: no number has an interval.
        path = write_walks(folder / "one.csv", n_people=12)
        frame = pd.read_csv(path)
        frame["group"] = "all"
        frame.to_csv(path, index=False)
        small = {"dataset": str(path), "mechanisms": ("raw",), "attacks": (), "tasks": ()}
        outs = [
            run(settings, f"one{radius}", **small, stages=StageSettings().changed(values))
            for radius in (0.3, 0.5)
            for values in ({"privacy.epsilon_m": radius},)
        ]
        assert len(read_manifest(outs[0])["groups"]) == 1
        assert compare.main([str(outs[0]), str(outs[1]), "--fail-on-change"]) == 2
        assert "no headline number" in capsys.readouterr().err


def write_verdict(out, decisions):
    items = [{"id": name, "decision": one, "section": "validity"} for name, one in decisions]
    (out / "verdict.json").write_text(json.dumps({"items": items}))


class TestVerdicts:
    @pytest.fixture
    def pair(self, narrow, tmp_path):
        copies = [shutil.copytree(narrow, tmp_path / name) for name in ("a", "b")]
        for copy in copies:
            (copy / "verdict.json").unlink(missing_ok=True)
        return copies

    def test_decisions_that_changed_are_listed(self, pair, capsys):
        write_verdict(pair[0], [("x", "tracks"), ("y", "undecided"), ("z", "holds")])
        write_verdict(pair[1], [("x", "does not track"), ("y", "undecided"), ("w", "holds")])
        assert compared(*pair).verdicts == {
            "in_both": 2,
            "only_a": ["z"],
            "only_b": ["w"],
            "changed": [{"id": "x", "a": "tracks", "b": "does not track"}],
        }
        assert compare.main([str(one) for one in pair]) == 0
        text = capsys.readouterr().out
        assert "1 of 2 decisions changed (1 only in A, 1 only in B)" in text
        assert "x: tracks -> does not track" in text

    def test_one_alone_and_two_mechanisms_have_none(self, pair):
        write_verdict(pair[0], [("x", "tracks")])
        found = compared(*pair)
        assert found.verdicts is None
        assert "Verdict" not in shown(found)
        write_verdict(pair[1], [("x", "tracks")])
        assert compared(*pair).verdicts is not None
        assert compared(*pair, mechanism_a="raw", mechanism_b="raw").verdicts is None

    @pytest.mark.parametrize("content", ["{", "[]", '{"items": [1]}', '{"items": [{"id": "x"}]}'])
    def test_a_broken_verdict_is_named(self, pair, content, capsys):
        write_verdict(pair[0], [("x", "tracks")])
        (pair[1] / "verdict.json").write_text(content)
        assert compare.main([str(one) for one in pair]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert str(pair[1] / "verdict.json") in line
