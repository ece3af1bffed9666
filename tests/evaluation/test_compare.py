"""Two runs side by side: what changed, which numbers differ, and how sure that is."""

import io
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.commands import assert_refused, start
from helpers.runs import stored_rows
from helpers.small_runs import smoke, write_walks
from helpers.summaries import edit_manifest
from rich.console import Console
from scipy.stats import t as student

import evaluation
from evaluation import compare
from evaluation.estimates import summary
from evaluation.estimates.differences import COLUMNS
from evaluation.estimates.differences import compare as compared
from evaluation.estimates.metrics import METRICS
from evaluation.estimates.run_settings import pairing
from evaluation.reporting.difference_tables import show
from evaluation.store.manifest import read_manifest
from isac_track.config import StageSettings
from isac_track.linkability.significance import holm

KEY = ["mechanism", "level", "consumer", "knowledge", "metric"]
PLR = ("fixed", 0.7, "shared", "", "plr")
EFFECT = ["difference", "ci_low", "ci_high"]
MECHANISMS = (
    "raw",
    "fid:1",
    *(
        f"fixed:{level}{rule}"
        for rule in ("", ",adding=independent")
        for level in ("0.7", "1")
    ),
)
ALONE = {"predictors": (), "attacks": (), "tasks": ()}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run by its name, computed when it is asked for: `base` with some changes."""
    folder = tmp_path_factory.mktemp("compare")
    walks = write_walks(folder / "walks.csv")
    axes = {
        "mechanisms": MECHANISMS,
        "attacks": ("kalman_rts", "shape"),
        "tasks": ("rerelease",),
    }
    others = write_walks(folder / "others.csv", n_people=24, seed=7)
    # The group column makes one cluster of everybody.
    result = write_walks(folder / "one.csv", n_people=12)
    pd.read_csv(result).assign(group="all").to_csv(result, index=False)
    own_options = {
        "dataset": str(result),
        "mechanisms": ("raw",),
        "attacks": (),
        "tasks": (),
    }
    usual = StageSettings().changed({"conflict.horizons_s": ()})
    wide = {"stages": usual.changed({"privacy.epsilon_m": 0.5})}
    longer = {"stages": usual.changed({"resample.min_duration_s": 28.0})}
    ahead = {"mechanisms": ("raw", "fixed:0.7"), "attacks": (), "tasks": ()}
    ahead["stages"] = usual.changed({"conflict.horizons_s": 3})
    changes = {
        "ahead": ahead,
        "ahead_reseeded": ahead | {"seed": 1},
        "base": {},
        "wide": wide,
        "reseeded": {"seed": 1},
        "others": {"dataset": str(others)},
        "narrow": {"mechanisms": ("raw",), **ALONE},
        "apart": {"mechanisms": ("fixed:0.3",), **ALONE},
        "longer": {"mechanisms": ("fixed:0.7",), **ALONE, **longer},
        "one": own_options,
        "one_wide": own_options | wide,
    }

    def made(name):
        out = folder / name
        if not out.exists():
            settings = smoke(walks, out, scenes=20, **axes)
            evaluation.run(
                replace(settings, **changes[name]), progress=False, pictures=False
            )
        return out

    return made


@pytest.fixture
def both(run):
    """Compare two runs by their names."""
    return lambda a, b: compared(run(a), run(b))


@pytest.fixture
def command(run, ran):
    """Exit code, output and errors of the command; runs are named in braces."""

    def said(*words):
        named = [
            run(word[1:-1]) if word[:1] == "{" else word for word in map(str, words)
        ]
        return ran(compare, *named)

    return said


def numbers(out):
    """The rows of a run's summary that have a value, by key."""
    frame = pd.read_csv(out / "summary.csv").fillna({"knowledge": ""})
    return frame.dropna(subset=["value"]).set_index(KEY)


def by_key(comparison):
    return comparison.rows.set_index(KEY)


def plr_replicates(out, *, weights, groups=None, spec="fixed:0.7"):
    """PLR as shared and its replicates, straight from the cells."""
    rows = stored_rows(out, spec, "shared")
    by_group = rows.groupby("group", observed=True)["plr"].agg(["sum", "count"])
    by_group = by_group.reindex(groups or read_manifest(out)["groups"]).fillna(0.0)
    value = by_group["sum"].sum() / by_group["count"].sum()
    return value, (weights @ by_group["sum"]) / (weights @ by_group["count"])


def shown(comparison, *, width=116, every=False):
    raw = io.StringIO()
    show(
        comparison, every=every, console=Console(file=raw, width=width, highlight=False)
    )
    return raw.getvalue()


def test_the_same_settings_give_the_same_numbers_and_the_text_says_so(
    run, command, tmp_path
):
    again = shutil.copytree(run("base"), tmp_path / "again")
    edit_manifest(
        again, lambda manifest: manifest.update(wall_time_s=1e3, dropped_cells=7)
    )
    result = compared(run("base"), again)
    assert set(result.rows["finding"]) == {"identical"}
    assert set(result.rows["pairing"]) == {"people and draws"}
    assert (result.rows[EFFECT] == 0.0).all(axis=None)
    assert not any(result.changed.values())
    assert result.only == {}
    code, text, errors = command("{base}", again, "--fail-on-change")
    assert (code, errors) == (0, "")
    assert "Nothing changed in data, settings, code and libraries." in text
    assert f"{len(result.rows)} of {len(result.rows)} numbers are identical" in text


class TestFurtherHorizon:
    def test_every_number_is_compared_with_itself_at_the_same_horizon(self, run, both):
        a, b = (
            pd.read_csv(
                run(name) / "summary.csv",
                keep_default_na=False,
                na_values={"level": "", "value": ""},
            )
            for name in ("ahead", "ahead_reseeded")
        )
        world = a["dataset"].iloc[0] + ":horizon=3s"
        a, b = (
            rows[rows["dataset"] == world]
            .dropna(subset=["value"])
            .set_index(KEY)["value"]
            for rows in (a, b)
        )
        rows = both("ahead", "ahead_reseeded").rows
        ahead = rows[rows["world"] == "horizon=3s"].set_index(KEY)
        assert len(a) > 0
        assert ahead["a"].sort_index().to_numpy() == pytest.approx(
            a.sort_index().to_numpy()
        )
        assert ahead["b"].sort_index().to_numpy() == pytest.approx(
            b.sort_index().to_numpy()
        )
        own = rows[rows["world"] == ""].set_index(KEY)
        assert (own.loc[ahead.index, "a"] != ahead["a"]).any()

    def test_conflicts_to_come_are_of_the_headline_and_lead(self, both):
        comparison = both("ahead", "ahead_reseeded")
        rows = comparison.rows
        headline = set(rows.loc[rows["headline"] & (rows["world"] != ""), "metric"])
        assert headline == {"missed_future_rate"}
        lead = comparison.lead
        assert [*lead.loc[lead["world"] != "", "metric"].unique()] == [
            "missed_future_rate"
        ]
        assert [*lead["metric"]].index("missed_future_rate") > 0
        assert "3 s ahead" in shown(comparison)

    def test_a_run_without_it_is_compared_at_its_own(self, both):
        comparison = both("base", "ahead")
        assert set(comparison.rows["world"]) == {""}
        assert comparison.only_numbers[1] > 0


class TestAnotherRadius:
    def test_the_setting_is_all_that_changed_and_moves_what_it_defines(self, both):
        result = both("base", "wide")
        setting = {"privacy.epsilon_m": (0.3, 0.5)}
        assert result.changed == {"data": {}, "settings": setting, "code": {}}
        assert "privacy.epsilon_m  0.3 -> 0.5" in shown(result)
        moved = set(result.rows.query("finding != 'identical'")["metric"])
        assert {"plr", "ael", "mel"} <= moved
        epsilon_rows = {
            "plr_wide",
            "plr_worst_tenth",
            "plr_over_benchmark",
            "plr_ceiling",
        }
        assert moved <= {"plr", "ael", "mel"} | epsilon_rows
        assert set(result.rows["pairing"]) == {"people and draws"}

    def test_differences_are_those_of_the_summaries(self, run, both):
        differences, a, b = (
            by_key(both("base", "wide")),
            *(numbers(run(item)) for item in ("base", "wide")),
        )
        expected = pd.DataFrame(
            {"a": a["value"], "b": b["value"], "difference": b["value"] - a["value"]}
        )
        pd.testing.assert_frame_equal(
            differences[[*expected]].sort_index(), expected.sort_index()
        )

    @pytest.mark.parametrize("other", ["wide", "reseeded"])
    def test_the_interval_is_that_of_the_same_people_drawn_for_both(
        self, run, both, other
    ):
        weights = summary.bootstrap_weights(read_manifest(run("base")))
        (a, drawn_a), (b, drawn_b) = (
            plr_replicates(run(name), weights=weights) for name in ("base", other)
        )
        row = by_key(both("base", other)).loc[PLR]
        error = (drawn_b - drawn_a).std(ddof=1)
        expected = [b - a, *np.quantile(drawn_b - drawn_a, [0.025, 0.975])]
        assert [*row[EFFECT]] == pytest.approx(expected, abs=1e-12)
        assert row["t"] == pytest.approx((b - a) / error)
        assert row["p_value"] == pytest.approx(
            2 * student.sf(abs(b - a) / error, df=row["n"] - 1)
        )

    def test_holm_runs_over_either_family_and_the_surest_come_first(self, both):
        rows = both("base", "wide").rows
        assert rows["p_value"].dropna().is_monotonic_increasing
        controls = rows["consumer"].str.contains("/control-")
        assert controls.any()
        headline = {name for name, metric in METRICS.items() if metric.is_headline}
        assert (rows["headline"] == rows["metric"].isin(headline) & ~controls).all()
        for _, family in rows.groupby("headline"):
            adjusted = holm(family["p_value"].to_numpy())
            assert family["p_holm"].to_numpy() == pytest.approx(adjusted, nan_ok=True)
        tested = rows[(rows["finding"] != "identical") & rows["p_holm"].notna()]
        assert ((tested["finding"] == "differs") == (tested["p_holm"] <= 0.05)).all()
        assert (rows["finding"] == "differs").any()


def test_another_seed_moves_no_headline_number_and_the_text_says_what_is_paired(both):
    # Of one population: a false "differs" has a chance of at most 5 %, and the seeds
    # are fixed.
    result = both("base", "reseeded")
    assert "differs" not in set(result.headline["finding"])
    text = shown(result, width=300)
    assert re.search(r"seed +0 -> 1", text)
    assert "paired over people, not over draws" in text
    assert "not paired: intervals of independent estimates" in text
    some, every = shown(result), shown(result, every=True)
    assert "The 20 surest of" in some
    assert "AUC" not in some
    assert "AUC" in every


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
def test_a_setting_pairs_scenes_and_linkage(run, name, value, scenes, linkage):
    first, second = (read_manifest(run("base")) for _ in range(2))
    task = second["linkage"]["tasks"]["rerelease"]
    changed = task if name == "people" else second["identity"]
    assert name in changed
    changed[name] = value
    result = [
        pairing(first, second, consumer=item) for item in ("shared", "rerelease/shape")
    ]
    assert result == [scenes, linkage]


class TestOtherPeople:
    def test_nothing_is_paired_and_intervals_combine_those_of_either_run(
        self, run, both
    ):
        result = both("base", "others")
        assert set(result.rows["pairing"]) == {"none"}
        # Galleries of two sizes do not compare.
        assert (
            result.rows.loc[result.rows["metric"] == "rank1", "difference"].isna().all()
        )
        assert set(result.lead["metric"]) == {"missed_conflict_rate", "plr"}
        assert {"sha256", "tracks", "tracks_used"} <= result.changed["data"].keys()
        assert re.search(r"tracks_used +30 -> 24", shown(result))
        first, two = (numbers(run(name)).loc[PLR] for name in ("base", "others"))
        value = two["value"] - first["value"]
        low = value - np.hypot(
            two["value"] - two["ci_low"], first["ci_high"] - first["value"]
        )
        high = value + np.hypot(
            two["ci_high"] - two["value"], first["value"] - first["ci_low"]
        )
        row = by_key(result).loc[PLR]
        assert [*row[EFFECT]] == pytest.approx([value, low, high], abs=1e-12)

    def test_who_is_in_both_runs_is_drawn_alike(self, run, both):
        everybody = read_manifest(run("base"))["groups"]
        assert (len(everybody), len(read_manifest(run("longer"))["groups"])) == (30, 20)
        weights = summary.bootstrap_weights(read_manifest(run("base")))
        (a, drawn_a), (b, drawn_b) = (
            plr_replicates(run(name), weights=weights, groups=everybody)
            for name in ("base", "longer")
        )
        for names, sign in ((("base", "longer"), 1), (("longer", "base"), -1)):
            row = by_key(both(*names)).loc[PLR]
            assert row["pairing"] == "people"
            ends = sign * np.quantile(drawn_b - drawn_a, [0.025, 0.975])[::sign]
            assert [*row[EFFECT]] == pytest.approx([sign * (b - a), *ends], abs=1e-12)


class TestCommand:
    def test_the_table_is_tidy_and_the_gate_shut_where_it_is_asked(
        self, both, command, tmp_path
    ):
        words = ["{base}", "{wide}", "--csv", tmp_path / "table.csv"]
        assert command(*words, "--fail-on-change")[0] == 1
        code, text, _ = command(*words)
        assert code == 0
        assert "identical" in text
        assert "PLR %" in text
        table, rows = pd.read_csv(tmp_path / "table.csv"), both("base", "wide").rows
        assert list(table.columns) == COLUMNS
        assert table["difference"].to_numpy() == pytest.approx(
            rows["difference"], nan_ok=True
        )

    def test_json_is_one_object_and_nothing_is_written_into_the_runs(
        self, run, both, command
    ):
        def held():
            files = [path for name in ("base", "wide") for path in run(name).rglob("*")]
            return {path: path.read_bytes() for path in files if path.is_file()}

        before = held()
        some, every = (
            json.loads(command("{base}", "{wide}", "--json", *more)[1])
            for more in ([], ["--all"])
        )
        assert held() == before
        assert some["changed"]["settings"] == {
            "privacy.epsilon_m": {"a": 0.3, "b": 0.5}
        }
        result = both("base", "wide")
        counts = some["numbers"]["headline"]
        assert [*counts] == ["identical", "differs", "between", "untested"]
        assert counts["differs"] == (result.headline["finding"] == "differs").sum()
        assert sum(counts.values()) == len(some["differences"]) == len(result.headline)
        assert (
            some["numbers"]["in_both"] == len(every["differences"]) == len(result.rows)
        )

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (["--nonsense"], ""),
            ([], ""),
            (["{base}"], ""),
            (["{base}", "/nowhere/at/all"], "/nowhere/at/all holds no run"),
            (["{base}", __file__], ""),
            (
                ["{base}", "{base}", "--csv", "/no/table.csv"],
                "cannot write /no/table.csv",
            ),
            (["{narrow}", "{apart}"], "share no number: A has raw, B has fixed"),
            (["{one}", "{one_wide}", "--fail-on-change"], "no headline number"),
        ],
    )
    def test_what_cannot_be_compared_ends_in_one_line(self, command, words, said):
        ended = command(*words)
        assert_refused(ended, said)
        assert len(ended.err.splitlines()) == 1

    @pytest.mark.parametrize("how", [["--json"], ["--all"]])
    def test_a_reader_who_leaves_early_sees_no_traceback(self, run, tmp_path, how):
        words = ("-m", "evaluation.compare", run("base"), run("wide"), *how)
        with start(tmp_path, *words) as process:
            process.stdout.close()
            assert process.stderr.read() == ""
        assert process.returncode == 141


class TestVerdicts:
    @pytest.fixture
    def pair(self, run, tmp_path):
        return [shutil.copytree(run("narrow"), tmp_path / name) for name in ("a", "b")]

    def write(self, pair, *verdicts):
        """Write what each decides, by its items' names."""
        for out, decisions in zip(pair, verdicts, strict=True):
            items = [
                {"id": name, "decision": decision}
                for name, decision in decisions.items()
            ]
            (out / "verdict.json").write_text(json.dumps({"items": items}))

    def test_decisions_that_changed_are_listed(self, pair, command):
        first = {"x": "tracks", "y": "between", "z": "holds"}
        self.write(pair, first, {"x": "does not track", "y": "between", "w": "holds"})
        assert compared(*pair).verdicts == {
            "in_both": 2,
            "only_a": ["z"],
            "only_b": ["w"],
            "changed": [{"id": "x", "a": "tracks", "b": "does not track"}],
        }
        code, text, _ = command(*pair)
        assert code == 0
        assert "1 of 2 decisions changed (1 only in A, 1 only in B)" in text
        assert "x: tracks -> does not track" in text
        (pair[1] / "verdict.json").unlink()
        assert compared(*pair).verdicts is None
        assert "Verdict" not in shown(compared(*pair))

    def test_a_broken_verdict_is_named(self, pair, command):
        (pair[1] / "verdict.json").write_text('{"items": [{"id": "x"}]}')
        assert_refused(command(*pair), str(pair[1] / "verdict.json"))
