"""Variants of a finished run: their changes, their runs, every item of a verdict."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.commands import assert_refused
from helpers.small_runs import smoke, write_walks
from helpers.summaries import edit_manifest

import evaluation
from evaluation import sensitivity
from evaluation.plan.plan import make_plan
from evaluation.plan.variants import (
    BASE,
    parse_variant,
    usual_variants,
    variant_settings,
)
from evaluation.reporting.difference_tables import sign_changes
from evaluation.sensitivity import main
from evaluation.store.manifest import read_manifest
from evaluation.store.people import with_paths
from evaluation.verdict import sensitivity as held
from evaluation.verdict.sensitivity import (
    COLUMNS,
    attack_tasks,
    read_verdict,
    variant_folder,
)
from isac_track.datasets import load
from isac_track.errors import DataError, SettingsError

NAMES = (
    BASE,
    "law=fixed_direction",
    "epsilon=1",
    "predictor=kalman_cv",
    "privacy.epsilon_m=0.4",
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A small run with every section of the verdict; kept as it is."""
    folder = tmp_path_factory.mktemp("finished")
    axes = {
        "mechanisms": (
            "raw",
            "fixed:0.2",
            "fixed:1",
            "fid:1",
            "fid:1e5",
            "correlated:0.75",
        ),
        "predictors": ("least_squares", "kalman_cv"),
        "attacks": ("identity", "kalman_rts", "shape", "histogram"),
        "tasks": ("rerelease",),
    }
    walks = write_walks(folder / "walks.csv")
    evaluation.run(smoke(walks, folder / "run", scenes=60, **axes), pictures=False)
    return folder / "run"


@pytest.fixture
def out(finished, tmp_path):
    """A copy to write into, without any variant."""
    return shutil.copytree(finished, tmp_path / "run")


@pytest.fixture(scope="module")
def little(tmp_path_factory):
    """A run of few levels and scenes, for all but its numbers; no test changes it."""
    folder = tmp_path_factory.mktemp("little")
    axes = {"mechanisms": ("raw", "fixed:0.2", "fixed:1"), "attacks": ("kalman_rts",)}
    evaluation.run(
        smoke(write_walks(folder / "walks.csv"), folder / "run", **axes), pictures=False
    )
    return folder / "run"


@pytest.fixture
def small(little, tmp_path):
    """A copy to write into, without any variant."""
    return shutil.copytree(little, tmp_path / "run")


@pytest.fixture(scope="module")
def tried(finished, tmp_path_factory):
    """The run after some of its variants."""
    folder = shutil.copytree(finished, tmp_path_factory.mktemp("tried") / "run")
    assert (
        main([str(folder), "--jobs=1", *(f"--variant={item}" for item in NAMES[:0:-1])])
        == 0
    )
    return folder


def item(name, decision, sign, **more):
    about = {
        "id": name,
        "section": name.partition("/")[0],
        "decision": decision,
        "sign": sign,
    }
    about |= {
        "adding": "linear",
        "descriptor": "plr",
        "task": "",
        "subject": "",
        "n": 40,
    }
    return (
        about
        | {"effect": 0.5, "ci_low": 0.25, "ci_high": 0.75, "unit": "fraction"}
        | more
    )


class TestNames:
    def test_the_list_is_the_one_that_is_promised_and_each_its_own_name(self):
        promised = (
            "base",
            "law=isotropic",
            "law=fixed_direction",
            "epsilon=0.1",
            "epsilon=0.2",
            "epsilon=0.5",
            "epsilon=1",
            "resample.min_duration_s=6",
            "ridge cap=1.5",
            "ridge cap=3",
            "ridge beam=4",
            "ridge exponent=2",
            "ridge exponent=3.5",
            "recording=students03",
            "recording=zara01",
            "recording=plaza",
            "predictor=kalman_cv",
            "predictor=least_squares",
        )
        assert usual_variants() == [parse_variant(name) for name in promised]
        assert tuple(variant.name for variant in usual_variants()) == promised

    @pytest.mark.parametrize("name", ["privacy.epsilon_m = 0.4", "epsilon=0.4"])
    def test_any_setting_makes_a_variant(self, name):
        assert parse_variant(name).stages == {"privacy.epsilon_m": 0.4}
        assert parse_variant("scenes.agents=3").stages == {"scenes.agents": 3}

    @pytest.mark.parametrize(
        ("name", "said"),
        [
            ("ridge cap=15", "did you mean 'ridge cap=1.5'?"),
            ("isotropic", "did you mean 'law=isotropic'?"),
            ("qqqqqq", "--list names them"),
            (
                "law=isotropc",
                "sensing.law must be one of radial, isotropic, fixed_direction",
            ),
            ("epsilon=wide", "privacy.epsilon_m must be a number"),
            ("epsilon=", "has no value"),
            ("predictor=kalman_cw", "did you mean"),
            ("recording=zara1", "did you mean zara01?"),
        ],
    )
    def test_a_wrong_name_says_what_was_meant(self, name, said):
        with pytest.raises((SettingsError, DataError), match=re.escape(said)):
            parse_variant(name)

    def test_what_the_run_did_itself_is_left_out(self, finished):
        manifest = read_manifest(finished)
        recordings = {"recording=students03", "recording=zara01", "recording=plaza"}
        names = {variant.name for variant in usual_variants(manifest)}
        assert names >= recordings | {"predictor=kalman_cv"}
        assert "predictor=least_squares" not in names
        manifest["dataset"]["name"] = "zara01"
        manifest["settings"]["stages"] |= {
            "sensing.law": "isotropic",
            "privacy.epsilon_m": 0.5,
        }
        manifest["settings"]["predictors"] = ["kalman_cv"]
        names = {variant.name for variant in usual_variants(manifest)}
        missing = {
            "recording=zara01",
            "law=isotropic",
            "epsilon=0.5",
            "predictor=kalman_cv",
        }
        assert names.isdisjoint(missing)
        assert {"base", "recording=students03", "predictor=least_squares"} <= names
        manifest["settings"]["predictors"] = []
        assert not any(variant.predictor for variant in usual_variants(manifest))


class TestChanges:
    @pytest.mark.parametrize(
        ("before", "after", "change"),
        [
            (("holds", 1), ("holds", 1), "same"),
            (("tracks", 1), ("tracks weakly", 1), "same"),
            (("between", 0), ("between", 0), "not decided before and after"),
            (("holds", 1), ("reversed", -1), "changed sign"),
            (("does not track", -1), ("tracks", 1), "changed sign"),
            (("reversed", -1), ("between", 0), "lost"),
            (("between", 0), ("inflated", 1), "gained"),
            (("holds", 1), (None, None), "missing"),
            (("between", 0), (None, None), "missing"),
        ],
    )
    def test_of_one_item(self, before, after, change):
        name, effect = ("claim/new", None) if change == "missing" else ("claim/a", -0.5)
        base = {"items": [item("claim/a", *before)]}
        said = {"items": [item(name, *after, effect=-0.5)]}
        (row,) = held.changes("v", base=base, varied=said)
        assert (row["id"], row["changed"]) == ("claim/a", change)
        assert (row["decision_base"], row["sign_base"], row["effect_base"]) == (
            *before,
            0.5,
        )
        assert (row["decision"], row["sign"], row["effect"]) == (*after, effect)

    def test_are_counted_and_told_in_words(self):
        nothing = dict.fromkeys(("effect", "ci_low", "ci_high"))
        same = [
            item("claim/c", "between", 0, **nothing),
            item("inflation/a", "inflated", 1, unit="s"),
        ]
        before = [item("claim/a", "holds", 1), item("claim/b", "holds", 1)]
        after = [
            item("claim/a", "reversed", -1, effect=-0.25, ci_low=-0.5, ci_high=-0.125),
            item("claim/b", "between", 0),
        ]
        result = held.changes(
            "law=x", base={"items": before + same}, varied={"items": after + same}
        )
        rows = pd.DataFrame(result, columns=list(COLUMNS))
        claim = {"not decided before and after": 1, "changed sign": 1, "lost": 1}
        assert held.counts(rows) == {
            "law=x": {"claim": claim, "inflation": {"same": 1}}
        }
        message = "law=x: claim/a: holds (0.5) -> reversed (-0.25 [-0.5, -0.125])"
        assert sign_changes(rows) == [message]


def settings(finished, name, *, manifest=None, out="nowhere", **more):
    """The settings of a variant of a run, and what is left out."""
    return variant_settings(
        parse_variant(name),
        manifest=with_paths(
            finished, read_manifest(finished) if manifest is None else manifest
        ),
        attacks=attack_tasks(read_verdict(finished)["items"]),
        out=Path(out),
        **more,
    )


class TestSettings:
    @pytest.mark.parametrize(
        "name", [BASE, "law=isotropic", "epsilon=0.2", "ridge beam=4"]
    )
    def test_one_thing_is_changed(self, finished, name):
        ran = read_manifest(finished)["settings"]
        variant, _ = settings(finished, name)
        changed = variant.stages.flat().items() - ran["stages"].items()
        assert dict(changed) == parse_variant(name).stages
        assert variant.dataset == settings(finished, BASE)[0].dataset
        assert variant.predictors == ("least_squares",)
        # Of the attacks those that the verdict is about.
        wanted = set(attack_tasks(read_verdict(finished)["items"]))
        assert set(variant.attacks) == wanted < set(ran["attacks"])
        for key in ("mechanisms", "tasks"):
            assert getattr(variant, key) == tuple(ran[key])
        assert (variant.scenes, variant.seed) == (ran["scenes"], ran["seed"])

    def test_another_recording_brings_its_own_format_and_leaves_out_what_it_is_too_small_for(
        self, finished, tmp_path
    ):
        changed, left_out = settings(finished, "recording=plaza")
        assert (changed.dataset, changed.format, changed.fps, left_out) == (
            "plaza",
            None,
            None,
            (),
        )
        write_walks(tmp_path / "few.csv", n_people=2)
        changed, left_out = settings(finished, f"recording={tmp_path / 'few.csv'}")
        assert (changed.tasks, changed.attacks) == ((), ("kalman_rts",))
        assert ["rerelease" in item for item in left_out] == [True]

    def test_a_recording_that_has_changed_is_refused(self, finished):
        manifest = read_manifest(finished)
        manifest["dataset"]["sha256"] = "0" * 64
        with pytest.raises(DataError, match="no longer the recording"):
            settings(finished, BASE, manifest=manifest)

    def test_a_file_is_read_as_the_run_has_read_it(self, finished, tmp_path):
        lines = write_walks(tmp_path / "walks.csv").read_text().splitlines()
        # The first sample twice, at two places; and names of the recording's own.
        t, person, x, y = lines[1].split(",")
        twice = f"{t},{person},{float(x) + 0.5},{y}"
        walks = tmp_path / "odd.csv"
        walks.write_text("\n".join(["time,ped,px,py", twice, *lines[1:], ""]))
        reading = {
            "columns": "t=time,id=ped,x=px,y=py",
            "on_duplicate": "mean",
            "drop_frozen": 3.0,
        }
        ran = make_plan(smoke(walks, scenes=60, **reading))
        assert {name: ran.identity[name] for name in reading} == reading
        manifest = with_paths(finished, read_manifest(finished))
        manifest["identity"] = ran.identity
        manifest["dataset"] |= {"path": str(walks), "sha256": ran.dataset.sha256}
        changed, _ = variant_settings(
            parse_variant(BASE), manifest=manifest, attacks={}, out=tmp_path / "base"
        )
        assert make_plan(changed).identity == ran.identity

    def test_a_known_recording_is_repaired_as_in_the_run(self, finished):
        manifest = read_manifest(finished)
        manifest["dataset"] |= {"name": "plaza", "sha256": load("plaza").sha256}
        manifest["identity"]["on_duplicate"] = "mean"
        changed, _ = settings(finished, BASE, manifest=manifest)
        assert (changed.dataset, changed.on_duplicate) == ("plaza", "mean")
        changed, _ = settings(finished, "recording=plaza", manifest=manifest)
        assert changed.on_duplicate == "error"


class TestRun:
    def test_the_table_holds_every_item_and_the_base_says_what_the_run_says(
        self, finished, tried
    ):
        rows = pd.read_csv(tried / "sensitivity.csv")
        assert tuple(rows.columns) == COLUMNS
        assert tuple(dict.fromkeys(rows["variant"])) == NAMES
        assert not rows.duplicated(["variant", "id"]).any()
        assert len(set(rows["variant"].value_counts())) == 1
        base = rows[rows["variant"] == BASE]
        assert len(base) == len(read_verdict(finished)["items"]) > 10
        assert set(base["section"]) == {"validity", "within", "claim", "inflation"}
        decided = np.where(base["sign"] == 0, "not decided before and after", "same")
        assert (base["changed"] == decided).all()
        assert np.array_equal(base["effect"], base["effect_base"], equal_nan=True)

    def test_a_variant_is_the_run_that_its_settings_make(
        self, finished, tried, tmp_path
    ):
        asked, _ = settings(finished, "epsilon=1", out=tmp_path / "alone", jobs=1)
        evaluation.run(asked, pictures=False)
        for name in ("summary.csv", "verdict.json"):
            variant_rows = variant_folder(tried, "epsilon=1") / name
            assert variant_rows.read_bytes() == (tmp_path / "alone" / name).read_bytes()

    def test_cells_that_the_run_has_are_not_computed_again(self, tried):
        def list_cells(folder):
            return {
                path.name: path.read_bytes() for path in (folder / "cells").iterdir()
            }

        run = list_cells(tried)
        for name in (BASE, "predictor=kalman_cv"):
            cells = list_cells(variant_folder(tried, name))
            assert cells
            # A unit's file is taken over whole, whoever else is in it.
            assert cells.items() <= run.items()
        assert list_cells(variant_folder(tried, "epsilon=1")).keys().isdisjoint(run)

    def test_the_same_command_computes_nothing_again_and_what_was_run_stays(
        self, tried, ran, monkeypatch
    ):
        monkeypatch.setenv("COLUMNS", "200")  # all sections beside each other
        cells = variant_folder(tried, "epsilon=1") / "cells"
        before = {path.name: path.stat().st_mtime_ns for path in cells.iterdir()}
        table = (tried / "sensitivity.csv").read_bytes()
        shown = ran(sensitivity, tried, "--jobs", "1", "--variant", "epsilon=1")
        assert shown.code == 0
        assert {
            path.name: path.stat().st_mtime_ns for path in cells.iterdir()
        } == before
        assert (tried / "sensitivity.csv").read_bytes() == table
        _, head, *lines = [line for line in shown.out.splitlines() if line]
        assert head.split() == ["variant", "validity", "within", "claim", "inflation"]
        for name in NAMES:
            (line,) = [line for line in lines if line.startswith(f"{name} ")]
            assert re.search(r"\d+ (same|not decided)", line)
        # The last sentence counts every item but the base's.
        others = pd.read_csv(tried / "sensitivity.csv").query("variant != 'base'")
        said = re.search(
            r"\d+ items have the same decision.*", " ".join(shown.out.split())
        )[0]
        counted = re.findall(
            r"(\d+) (?:items|not decided|changed sign|lost|gained|miss)", said
        )
        assert sum(map(int, counted)) == len(others)

    def test_the_run_itself_is_left_alone(self, finished, tried):
        def content(folder):
            files = {
                path.relative_to(folder): path
                for path in folder.rglob("*")
                if path.is_file()
            }
            return {name: path.read_bytes() for name, path in files.items()}

        after = content(tried).items() - content(finished).items()
        assert {name.parts[0] for name, _ in after} == {
            "sensitivity",
            "sensitivity.csv",
        }
        assert content(finished).items() <= content(tried).items()

    def test_set_adds_to_what_runs(self, tried, ran):
        words = ["--jobs=1", "--variant=base", "--set=privacy.epsilon_m=0.4", "--json"]
        said = json.loads(ran(sensitivity, tried, *words).out)
        message = {variant["name"]: variant["state"] for variant in said["variants"]}
        assert message == dict.fromkeys((BASE, "privacy.epsilon_m=0.4"), "finished")
        assert tuple(said["counts"]) == NAMES
        assert len(said["items"]) == len(NAMES) * len(read_verdict(tried)["items"])


class TestTable:
    def test_variants_of_other_scenes_or_code_are_left_out_and_told(
        self, tried, tmp_path
    ):
        out = shutil.copytree(tried, tmp_path / "run")
        for name, change in (
            ("epsilon=1", lambda manifest: manifest.update(code="0")),
            ("law=fixed_direction", lambda manifest: manifest.update(state="running")),
            (
                "predictor=kalman_cv",
                lambda manifest: manifest["identity"].update(scenes=8),
            ),
        ):
            edit_manifest(variant_folder(out, name), change)
        rows, left_out = held.collect(out)
        assert set(rows["variant"]) == {BASE, "privacy.epsilon_m=0.4"}
        assert left_out == {
            "epsilon=1": "it is of another version of the code",
            "law=fixed_direction": "it is not finished",
            "predictor=kalman_cv": "it has another seed or number of scenes",
        }

    def test_all_but_the_base_are_held_against_the_base(self, tried, tmp_path):
        out = shutil.copytree(tried, tmp_path / "run")
        path = variant_folder(out, BASE) / "verdict.json"
        said = json.loads(path.read_text())
        for item in said["items"]:
            if item["section"] == "inflation":
                assert item["sign"] == 1
                item |= {"sign": -1, "decision": "deflated"}
        path.write_text(json.dumps(said))
        rows, _ = held.collect(out)
        inflation = rows[rows["section"] == "inflation"].set_index("variant")
        for name, before in ((BASE, 1), ("predictor=kalman_cv", -1)):
            assert set(inflation.loc[[name], "sign_base"]) == {before}
            assert set(inflation.loc[[name], "changed"]) == {"changed sign"}
        assert len(sign_changes(rows)) >= 2 * len(inflation.loc[[BASE]])


class TestErrors:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (
                None,
                (
                    "{out}/verdict.json is missing; python -m evaluation.report {out}"
                    " writes it"
                ),
            ),
            ('{"items": []}', "has no items"),
            *(
                (text, "verdict.json cannot be read")
                for text in ("{", "[]", '{"items": [1]}')
            ),
        ],
    )
    def test_a_verdict_that_is_none(self, tmp_path, text, message):
        if text is not None:
            (tmp_path / "verdict.json").write_text(text)
        with pytest.raises(DataError, match=re.escape(message.format(out=tmp_path))):
            read_verdict(tmp_path)

    def test_a_run_that_is_not_finished(self, out, ran):
        edit_manifest(out, lambda manifest: manifest.update(state="running"))
        message = f"the run in {out} is not finished; run the matrix again"
        assert_refused(ran(sensitivity, out), message)

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["{out}", "--variant", "law=isotrpic"], "must be one of"),
            (["{out}", "--variant", "epsilon=0.3"], "changes nothing"),
            (["{out}", "--set", "predictor=kalman_cv"], "--set takes STAGE.KEY=VALUE"),
            (["{out}", "--scenes", "1"], "at least 2 scenes"),
            (["{out}", "--wrong"], "unrecognized arguments"),
            ([], "name the folder"),
        ],
    )
    def test_wrong_usage_is_one_line_and_nothing_is_run(self, out, ran, words, message):
        assert_refused(
            ran(sensitivity, *(word.format(out=out) for word in words)), message
        )
        assert not (out / "sensitivity.csv").exists()

    def test_a_variant_that_fails_is_told_and_the_rest_goes_on(
        self, small, ran, monkeypatch
    ):
        monkeypatch.setenv("ISAC_TRACK_DATA", str(small / "nothing"))
        monkeypatch.setenv("ISAC_TRACK_CACHE", str(small / "nothing"))
        words = [
            "--scenes=8",
            "--variant=recording=zara01",
            "--variant=predictor=kalman_cv",
        ]
        code, _, errors = ran(sensitivity, small, "--jobs=1", *words)
        assert code == 3
        assert "failed: recording=zara01: zara01: obsmat.txt not found" in errors
        assert "datasets fetch zara01" in errors
        rows = pd.read_csv(small / "sensitivity.csv")
        assert set(rows["variant"]) == {BASE, "predictor=kalman_cv"}

    def test_a_variant_of_other_scenes_is_not_overwritten_unless_asked(
        self, small, ran
    ):
        words = [sensitivity, small, "--jobs=1", "--variant=base", "--scenes"]
        assert ran(*words, 8).code == 0
        assert_refused(ran(*words, 10), "holds another run (scenes 8 -> 10)")
        assert ran(*words, 10, "--fresh").code == 0
        assert read_manifest(variant_folder(small, BASE))["settings"]["scenes"] == 10

    def test_an_interrupted_run_says_how_to_continue(self, small, ran, monkeypatch):
        def interrupted():
            raise KeyboardInterrupt

        monkeypatch.setattr(sensitivity, "check_interrupt", interrupted)
        code, _, errors = ran(
            sensitivity, small, "--jobs=1", "--scenes=8", "--variant=base"
        )
        assert code == 130
        assert "the same command continues" in errors
        assert read_manifest(variant_folder(small, BASE))["state"] == "finished"
