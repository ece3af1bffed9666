"""`python -m attacks`: list, check, and a package of one's own in one command."""

import re
import sys
import tomllib
from importlib.metadata import EntryPoint

import pytest
from helpers.commands import run
from helpers.processes import ROOT

from attacks.__main__ import KINDS, main
from attacks.testing import (
    CHECKS,
    LINKAGE_CHECKS,
    MECHANISM_CHECKS,
    POLICY_CHECKS,
    PREDICTOR_CHECKS,
    TRACKER_CHECKS,
)
from isac_track import plugins
from isac_track.plugins import KIND_BY_NOUN

GUIDE = (ROOT / "docs" / "how-to" / "your-attack.md").read_text(encoding="utf-8")
BROKEN, LINKERS = "helpers.broken_attacks", "helpers.broken_linkers"


@pytest.fixture
def installed(monkeypatch):
    """Pretend that somebody has installed these attacks."""

    def install(kind="attacks", **points):
        entry_points = tuple(
            EntryPoint(*point, group=f"isac_track.{kind}") for point in points.items()
        )
        monkeypatch.setattr(
            plugins,
            "_entry_points",
            lambda asked: entry_points if asked == kind else (),
        )

    return install


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_list_names_rows_and_what_they_do_and_skips_broken_ones(capsys, installed):
    broken = {"lost": "no_such_module:Lost", "many": f"{LINKERS}:NeedsRepeats"}
    shared_frame = f"{BROKEN}:common_frame"
    installed(
        fine=f"{BROKEN}:own_dice", mine=shared_frame, linker=f"{LINKERS}:Tiny", **broken
    )
    assert main(["list"]) == 0
    captured = capsys.readouterr()
    head, *lines = captured.out.splitlines()
    assert head.split() == ["attack", "kind", "adversaries"]
    known = [name for name in plugins.names("attacks") if name not in broken]
    assert [line.split()[0] for line in lines] == known
    for row in (
        "identity +reconstruction +blind +Return the shared",
        "averaging +reconstruction +oracle ",
        "(moving_average|savgol) +reconstruction +blind, informed +[A-Z]",
        "(kalman|radial)_rts +reconstruction +blind, informed, oracle +[A-Z]",
        "corrector +reconstruction +informed, oracle +[A-Z]",
        "gaussian_process +reconstruction +blind, informed, oracle +slow ",
        (
            "(profile|dtw|shape|behaviour|histogram|kinematic|likelihood_ratio)"
            " +linkage +blind, info"
        ),
        "mine +reconstruction +oracle +Averages repeats as if",
        "linker +linkage +blind +Scores have",
        "fine +reconstruction +blind$",  # it has no docstring
    ):
        assert re.search(f"^{row}", captured.out, re.MULTILINE)
    assert (
        "skipped lost: attack 'lost' cannot be loaded from no_such_module"
        in captured.err
    )
    assert "skipped many: attack NeedsRepeats requires REPEATS" in captured.err


class TestCheck:
    def test_an_attack_with_parameters_that_passes(self, capsys):
        assert main(["check", "kalman_rts:0.1"]) == 0
        head, *lines, summary = capsys.readouterr().out.splitlines()
        assert head == "kalman_rts:q=0.1 as blind, informed, oracle:"
        assert lines == [f"  pass  {name}" for name in CHECKS]
        assert summary == f"{len(CHECKS)} passed, 0 failed, 0 skipped"

    def test_an_attack_that_fails_as_a_module(self, tmp_path):
        done = run(tmp_path, "-m", "attacks", "check", f"{BROKEN}:across_tracks")
        assert (done.code, done.err) == (1, "")
        assert f"{len(CHECKS) - 1} passed, 1 failed, 0 skipped" in done.out
        (failed,) = re.findall(r"^  FAIL  (\w+) +(.*)$", done.out, re.MULTILINE)
        assert failed[0] == "order_of_tracks_does_not_matter"
        assert failed[1].startswith("across_tracks as blind (granted nothing), 8 walks")

    def test_a_check_that_does_not_apply(self, capsys):
        assert main(["check", "averaging"]) == 0
        shown = capsys.readouterr().out
        assert shown.startswith("averaging as oracle:\n")
        assert (
            f"  skip  {'frame_and_clock_do_not_matter':<33}  granted SCENE in every row"
            in shown
        )
        assert shown.endswith(f"{len(CHECKS) - 1} passed, 0 failed, 1 skipped\n")

    @pytest.mark.parametrize(
        ("spec", "head", "checks"),
        [
            ("fid:100,adding=independent", "as a mechanism:", MECHANISM_CHECKS),
            ("predictors.kalman:KalmanCV", "as a predictor:", PREDICTOR_CHECKS),
            ("near:3.5", "as a policy:", POLICY_CHECKS),
            ("gnn", "as a tracker:", TRACKER_CHECKS),
        ],
    )
    def test_the_kind_follows_from_name_or_method(self, spec, head, checks, capsys):
        assert main(["check", spec]) == 0
        first, *lines, _ = capsys.readouterr().out.splitlines()
        assert first == f"{spec} {head}"
        assert lines == [f"  pass  {name}" for name in checks]

    @pytest.mark.parametrize(
        ("spec", "message"),
        [
            ("fixed", "fixed needs a value for d_sigma"),
            ("no_such.module:Noise", "cannot be loaded from no_such.module:Noise"),
            ("kalman_rst", "unknown attack 'kalman_rst'; did you mean 'kalman_rts'?"),
            ("posterior", "a package of its own: pip install ./examples/attacks"),
            (f"{BROKEN}:Nobody", f"cannot be loaded from {BROKEN}:Nobody"),
            ("kalman_rts:-1", "q must be positive"),
            (f"{LINKERS}:NeedsRepeats", "nobody who links is granted"),
            ("genie", "tracker Genie reads the truth: it is a reference"),
        ],
    )
    def test_wrong_usage(self, spec, message, capsys):
        assert main(["check", spec]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.startswith("error: ")
        assert message in captured.err


class TestNew:
    @pytest.mark.parametrize(
        ("name", "kind", "checks", "parameter"),
        [
            ("my_attack", "reconstruction", CHECKS, "tau_s"),
            ("my_linker", "linkage", LINKAGE_CHECKS, "bin_s"),
            ("my_noise", "mechanism", MECHANISM_CHECKS, "d_sigma"),
            ("my_tracker", "predictor", PREDICTOR_CHECKS, "window_s"),
            ("my_policy", "policy", POLICY_CHECKS, "metres"),
            ("my_association", "tracker", TRACKER_CHECKS, "gate_m"),
        ],
    )
    def test_it_works_as_it_is(
        self, name, kind, checks, parameter, capsys, installed, monkeypatch, pytester
    ):
        folder, class_name = pytester.path / name, name.title().replace("_", "")
        noun = KINDS[kind]["noun"]
        option = KINDS[kind].get("option", f"--{noun} +")
        group = KIND_BY_NOUN[noun]
        folder.mkdir()  # an empty folder is taken
        assert main(["new", name, "--kind", kind]) == 0
        texts = {path.name: path.read_text("utf-8") for path in folder.iterdir()}
        assert texts.keys() == {
            f"{name}.py",
            f"test_{name}.py",
            "pyproject.toml",
            "README.md",
        }
        assert not any("$" in text for text in texts.values())
        for file in ("README.md", "pyproject.toml"):
            assert re.search(f"A .*{kind}( attack)? for isac-track", texts[file])
        lines = (
            f"pip install -e ./{name}",
            f"pytest {name}",
            f"python -m evaluation.matrix {option}{name}",
        )
        shown = capsys.readouterr().out.splitlines()[1:]
        assert shown[:3] == [f"  {line}" for line in lines]
        board = {"reconstruction": "--attack", "policy": "--mechanism raw --policy"}
        board["mechanism"] = "--mechanism"
        on_board = (f"python -m evaluation.board {board.get(kind)} {name} cards",)
        assert [line[2:].partition(" --out")[0] for line in shown[3:]] == list(
            on_board * (kind in board)
        )
        assert (on_board[0] in texts["README.md"]) == (kind in board)
        assert all(f"\n{line}\n" in texts["README.md"] for line in lines)
        for line in ("python -m attacks new my_attack", *lines) * (noun == "attack"):
            assert f"\n{line.replace(name, 'my_attack')}\n" in GUIDE
        project = tomllib.loads(texts["pyproject.toml"])["project"]
        entry_points = project["entry-points"][f"isac_track.{group}"]
        assert (project["name"], entry_points) == (name, {name: f"{name}:{class_name}"})
        # Its own tests, from where it was made.
        done = pytester.runpytest_inprocess(
            "-W", "error", "-p", "no:cacheprovider", name
        )
        without = 2 * (kind == "predictor")  # it has no `track`, which is optional
        done.assert_outcomes(passed=2 * len(checks) - without, skipped=without)
        capsys.readouterr()
        # By name, once installed.
        monkeypatch.syspath_prepend(folder)
        installed(group, **entry_points)
        try:
            assert main(["list"]) == 0
            listed = capsys.readouterr().out
            row = re.search(rf"^{name} +{kind} +blind, informed ", listed, re.MULTILINE)
            assert bool(row) == (noun == "attack")
            assert main(["check", f"{name}:0"]) == 2
            assert f"{parameter} must be positive, got 0" in capsys.readouterr().err
        finally:
            sys.modules.pop(name, None)

    def test_ruff_and_its_formatter_have_nothing_to_say(self, here):
        for kind in KINDS:
            for name in (kind[-1] + kind[0], f"{kind[:3]}_with_quite_a_long_name"):
                assert main(["new", name, "--kind", kind]) == 0
        for words in (["check"], ["format", "--check"]):
            done = run(here, "-m", "ruff", *words, "--no-cache", ".")
            assert done.code == 0, done

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            (
                "My_Attack",
                "must be a lower-case Python identifier, .* did you mean 'my_attack'?",
            ),
            ("my attack!", "did you mean 'my_attack'?"),
            ("2nd", "'2nd' must be a lower-case Python identifier, as my_attack is\n"),
            ("", "must be a lower-case Python identifier, as my_attack is\n"),
            ("lambda", "'lambda' is a word of Python itself"),
            ("knowledge", "'knowledge' would call its class Knowledge, which is taken"),
            ("kalman_rts", "'kalman_rts' is the name of an attack already"),
            ("theirs", "'theirs' is the name of an attack already"),
            (
                "statistics",
                "'statistics' is the name of a Python module already; take another",
            ),
            ("isac_track", "'isac_track' is the name of a Python module already"),
        ],
    )
    def test_a_name_that_cannot_be(self, name, message, here, capsys, installed):
        installed(theirs="theirs:Theirs")
        assert main(["new", name]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert re.search(re.escape(message).replace(r"\.\*", ".*"), captured.err)
        assert list(here.iterdir()) == []

    def test_a_name_is_taken_by_its_own_kind_alone(self, here, capsys):
        assert main(["new", "fid", "--kind", "mechanism"]) == 2
        assert "'fid' is the name of a mechanism already" in capsys.readouterr().err
        assert main(["new", "fid", "--kind", "predictor"]) == 0
        assert [path.name for path in here.iterdir()] == ["fid"]

    def test_nothing_is_overwritten(self, here, capsys):
        existing = here / "my_attack" / "my_attack.py"
        existing.parent.mkdir()
        existing.write_text("work of weeks", encoding="utf-8")
        (here / "a_file").write_text("", encoding="utf-8")
        for name in ("my_attack", "a_file"):
            assert main(["new", name]) == 2
            message = f"{name} is there already; take another name, or --into DIR"
            assert message in capsys.readouterr().err
        assert existing.read_text(encoding="utf-8") == "work of weeks"
        assert main(["new", "other", "--into", "a_file"]) == 2
        assert "cannot write a_file" in capsys.readouterr().err


class TestCommandLine:
    @pytest.mark.parametrize(
        "words",
        [
            [],
            ["chekc"],
            ["check"],
            ["new"],
            ["list", "--all"],
            ["new", "mine", "--kind", "other"],
        ],
    )
    def test_wrong_usage_is_one_line(self, words, capsys):
        assert main(words) == 2
        assert re.fullmatch(r"error: .* \(see --help\)\n", capsys.readouterr().err)


def test_the_guide_runs_as_it_stands(pytester):
    files = re.findall(r"```python\n# (\w+\.py)\n(.*?)```", GUIDE, re.DOTALL)
    assert [name for name, _ in files][-2:] == ["my_attack.py", "test_my_attack.py"]
    for name, code in files:
        (pytester.path / name).write_text(code, encoding="utf-8")
    words = ["-W", "error", "-p", "no:cacheprovider", "-k", "tau_s"]
    done = pytester.runpytest_inprocess(*words)
    done.assert_outcomes(passed=len(CHECKS), deselected=len(CHECKS))
