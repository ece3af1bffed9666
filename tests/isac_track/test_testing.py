"""The metric suite itself: it catches mistakes, and works for others as documented."""

from __future__ import annotations

import re
import sys
from dataclasses import fields, replace
from math import nan
from unittest import SkipTest

import pytest
from helpers import broken_metrics, oracles
from helpers.broken_metrics import BROKEN
from helpers.processes import ROOT

from isac_track.errors import SettingsError
from isac_track.testing import (
    CHECKS,
    OWN,
    Metrics,
    parametrize_metric_checks,
    run_checks,
    select_checks,
)
from isac_track.testing.__main__ import main
from isac_track.testing._descriptor_checks import plain_track, random_tracks

DOCS = ROOT / "docs" / "how-to" / "check-your-metrics.md"


def run_check(metric, function, name):
    (outcome,) = run_checks(replace(OWN, **{metric: function}), names=[name])
    return outcome


class TestMistakesAreCaught:
    @pytest.mark.parametrize(
        ("metric", "broken", "name"),
        [
            pytest.param(metric, broken, name, id=name)
            for metric, mistakes in BROKEN.items()
            for broken, *names in mistakes
            for name in names
        ],
    )
    def test_by_the_check_that_is_about_them(self, metric, broken, name):
        outcome = run_check(metric, broken, name)
        assert outcome.status == "failed"
        assert outcome.message

    def test_by_each_check_at_least_once(self):
        caught = {
            name
            for mistakes in BROKEN.values()
            for _, *names in mistakes
            for name in names
        }
        assert {check.name for check in CHECKS} == caught

    def test_the_metrics_without_a_mistake_pass(self):
        metrics = {"plr": broken_metrics.plr(), "exposure": broken_metrics.exposure}
        durations = {"ael_s": broken_metrics.ael(), "mel_s": broken_metrics.mel()}
        outcomes = run_checks(Metrics(**metrics, **durations))
        assert {outcome.status for outcome in outcomes} == {"passed", "skipped"}

    @pytest.mark.parametrize(
        ("broken", "message"),
        [
            (
                lambda *_: "text"[9],
                "mel_s raised IndexError: string index out of range; called as",
            ),
            (
                lambda *_: sys.exit("enough"),
                "mel_s raised SystemExit: enough; called as mel_s([[",
            ),
            (
                broken_metrics.mel_changes_its_input,
                "mel_s changed its input; called as mel_s([[",
            ),
            (
                lambda *_: None,
                "mel_s returned None, which cannot be read as its result: ",
            ),
            (
                broken_metrics.duration(sum),
                "MEL is 1.0, expected 0.75; leakage pattern 101110,",
            ),
        ],
    )
    def test_with_a_counterexample(self, broken, message):
        assert message in run_check("mel_s", broken, "mel_hand_examples").message


def test_random_tracks_cover_what_matters_and_are_what_the_coordinates_say():
    patterns = []
    for track in [plain_track("0110"), *random_tracks("test")]:
        leaked = oracles.leaked_samples(
            shared_xy=track.shared_xy, true_xy=track.true_xy, epsilon_m=track.epsilon_m
        )
        patterns.append("".join("01"[sample] for sample in leaked))
        assert patterns[-1] == track.pattern
    assert {"0", "1"} <= set(patterns)
    assert any("1" * 6 in pattern for pattern in patterns)
    assert any(pattern.replace("0", " ").count("1 ") > 3 for pattern in patterns)


class TestRunning:
    def test_every_check_states_what_it_shows_and_every_function_is_checked(self):
        assert len({check.name for check in CHECKS}) == len(CHECKS)
        assert all(check.statement.endswith(".") and check.needs for check in CHECKS)
        needed = {need for check in CHECKS for need in check.needs}
        assert needed == {item.name for item in fields(Metrics)}

    def test_a_missing_function_is_skipped_with_the_reason(self):
        names = [
            "plr_hand_examples",
            "mel_is_at_least_ael",
            "mel_is_zero_exactly_when_plr_is",
        ]
        reasons = ["", "not offered: ael_s, mel_s", "not offered: mel_s"]
        assert [
            outcome.message for outcome in run_checks(Metrics(plr=OWN.plr), names=names)
        ] == reasons

    def test_checks_are_selected_by_name_and_once_and_a_wrong_one_gets_the_nearest(
        self,
    ):
        names = ["mel_single_sample", "plr_single_sample", "mel_single_sample"]
        assert [check.name for check in select_checks(names)] == names[:2]
        for wrong, message in (
            ("mel_single_sampel", r"did you mean 'mel_single_sample'\?"),
            ("xyzzy", "`--list` names all checks"),
        ):
            with pytest.raises(SettingsError, match=message):
                select_checks([wrong])

    def test_pytest_gets_one_case_per_check(self):
        mark = parametrize_metric_checks(Metrics(plr=lambda *_: nan)).mark
        assert mark.args[0] == "check"
        cases = {case.id: case.values[0] for case in mark.args[1]}
        assert list(cases) == [check.name for check in CHECKS]
        with pytest.raises(SkipTest, match=r"^not offered: ael_s$"):
            cases["ael_single_sample"]()
        with pytest.raises(AssertionError, match=r"PLR is nan, expected 0\.25"):
            cases["plr_hand_examples"]()
        few = parametrize_metric_checks(OWN, names=["grid_starts_now"]).mark.args[1]
        assert [case.id for case in few] == ["grid_starts_now"]


class TestCommand:
    def test_own_metrics_pass(self, capsys):
        names = ["grid_starts_now", "plr_hand_examples"]
        assert (
            main(["isac_track.testing:OWN", *(f"--check={name}" for name in names)])
            == 0
        )
        shown = [f"passed  {name}" for name in names] + [
            "2 passed, 0 failed, 0 skipped"
        ]
        assert capsys.readouterr().out.splitlines() == shown

    def test_failure_and_skips(self, capsys, module):
        name = module(
            "from isac_track.testing import Metrics\nM = Metrics(plr=lambda *_: 2.0)"
        )
        words = ["--check", "plr_single_sample", "--check", "mel_single_sample"]
        assert main([f"{name}:M", *words]) == 1
        counterexample = "leakage pattern 1, t = [0] s, epsilon 0.3 m"
        assert capsys.readouterr().out.splitlines() == [
            f"failed  plr_single_sample: PLR is 2.0, expected 1.0; {counterexample}",
            "skipped mel_single_sample: not offered: mel_s",
            "0 passed, 1 failed, 1 skipped",
        ]

    def test_list(self, capsys):
        assert main(["--list"]) == 0
        assert len(capsys.readouterr().out.splitlines()) == len(CHECKS)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ([], "name the functions to check: package.module:OBJECT"),
            (["--no-such-option"], "(see --help)"),
            ([":OWN"], "cannot import ':OWN', expected package.module:OBJECT"),
            (
                ["isac_track.testing:"],
                "must be an isac_track.testing.Metrics, got module",
            ),
            (
                ["no_such_package.x:OWN"],
                "expected package.module:OBJECT: ModuleNotFoundError",
            ),
            (
                ["isac_track.testing:OWEN"],
                "AttributeError: module 'isac_track.testing' has no",
            ),
            (
                ["isac_track.testing:CHECKS"],
                "must be an isac_track.testing.Metrics, got tuple",
            ),
            (
                ["isac_track.testing:OWN", "--check", "plr_hand"],
                "did you mean 'plr_hand_examples'",
            ),
            ("1 / 0", "ZeroDivisionError: division by zero"),
            ("raise SystemExit(0)", "SystemExit: 0"),
            (
                "from isac_track.testing import Metrics\nM = Metrics()",
                "offers no function",
            ),
        ],
    )
    def test_wrong_usage(self, arguments, message, capsys, module):
        """`arguments` are those of the command, or the text of a module with M."""
        words = [f"{module(arguments)}:M"] if isinstance(arguments, str) else arguments
        assert main(words) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert re.fullmatch(f"error: .*{re.escape(message)}.*\n", captured.err)


class TestDocumentation:
    """docs/reference/metrics.md as a reader uses it, in a folder of their own."""

    TEXT = DOCS.read_text(encoding="utf-8")
    BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)

    def test_example_runs(self, pytester, monkeypatch, capsys):
        for name, text in zip(
            ("my_metrics", "test_my_metrics"), self.BLOCKS, strict=True
        ):
            (pytester.path / f"{name}.py").write_text(text, encoding="utf-8")
        monkeypatch.syspath_prepend(pytester.path)
        assert main(["my_metrics:METRICS"]) == 0
        del sys.modules["my_metrics"]  # the name is free again for other tests
        shown = capsys.readouterr()
        assert shown.err == ""
        assert re.search(
            r"^\d+ passed, 0 failed, \d+ skipped$", shown.out, re.MULTILINE
        )
        assert "skipped ael_hand_examples: not offered: ael_s" in shown.out
        words = ["-W", "error", "-p", "no:cacheprovider", "-k", "single_sample"]
        done = pytester.runpytest_inprocess(*words)
        done.assert_outcomes(passed=2, skipped=1, deselected=len(CHECKS) - 3)

    def test_every_function_is_named(self):
        assert [
            item.name for item in fields(Metrics) if f"`{item.name}`" not in self.TEXT
        ] == []


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return a function that writes a third-party module and returns its name."""
    name = f"somebody_elses_{tmp_path.name.replace('-', '_')}"

    def write(text):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        return name

    yield write
    sys.modules.pop(name, None)
