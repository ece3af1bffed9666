"""Plug-ins with unusable numbers or errors: each fails alone and by name."""

import json
import os
import signal
import sys
import time
from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from helpers.recordings import write_csv
from helpers.small_runs import single_process
from helpers.walkers import walkers

from evaluation import matrix
from evaluation.compute.guards import guarded
from isac_track.command_line import check_interrupt, exit_code
from isac_track.types import ESTIMATE_LIMIT_M, SHARED_LIMIT_M

pytestmark = pytest.mark.usefixtures("undrawn")

PLUGINS = '''
import os
import signal
import sys
import time
from dataclasses import dataclass, replace

import numpy as np

from attacks.reconstruction.moving_windows import MovingAverage
from isac_track.sharing import Fixed
from isac_track.types import ESTIMATE_LIMIT_M, Prediction, Reconstruction
from predictors.kalman import KalmanCV


def is_trial(batch):
    """Whether these are the people that a plug-in is called with before the run."""
    return len(batch) == 12


@dataclass(frozen=True)
class Shared(Fixed):
    """As fixed noise, with every position moved and every sigma replaced."""

    d_sigma: float = 0.5
    east_m: float = 0.0
    sigma_m: float | None = None

    def share(self, sensed, rng):
        release = super().share(sensed, rng)
        if is_trial(sensed):
            return release
        xy = release.xy + np.array([self.east_m, 0.0])
        sigma = release.sigma if self.sigma_m is None else np.full_like(xy[:, 0], self.sigma_m)
        return replace(release, xy=xy, sigma=None if self.sigma_m == 0.0 else sigma)


@dataclass(frozen=True)
class Wrong(Shared):
    """What it is called with says what it does."""

    what: str = "nothing"

    def share(self, sensed, rng):
        if is_trial(sensed):
            return super().share(sensed, rng)
        if self.what == "mutates":
            sensed.xy[0] = 0
        release = super().share(sensed, rng)
        if self.what == "later":  # writes into what it has built already, when nobody looks
            xy = release.xy.copy()
            release = replace(release, xy=xy)
            xy[0] = np.nan
            return release
        return replace(release, t=release.t + 1) if self.what == "retimes" else None


class Strange(Shared):
    """Trips our own code: it is asked for this outside of `share`."""

    @property
    def errors_are_independent(self):
        raise KeyError("nobody expected this")


@dataclass(frozen=True)
class Predicted(KalmanCV):
    xx: float = 1.0
    yy: float = 1.0
    east_m: float = 0.0

    def predict(self, release, t_future):
        usual = super().predict(release, t_future)
        if is_trial(release):
            return usual
        mean = usual.mean + np.array([self.east_m, 0.0])
        return Prediction(mean, np.broadcast_to(np.diag([self.xx, self.yy]), (*mean.shape, 2)))


ERRORS = {
    "torn": ValueError("half a pair \\udcff and \\x1b[31mred"),
    "lengthy": ValueError("one\\ntwo\\n" + "all work and no play\\n" * 50_000),
    "leaves": SystemExit(0),
    "interrupts": KeyboardInterrupt(),
}


@dataclass(frozen=True)
class Fails(KalmanCV):
    what: str = "torn"

    def predict(self, release, t_future):
        if is_trial(release):
            return super().predict(release, t_future)
        raise ERRORS[self.what]


class Signals(KalmanCV):
    """While it runs, somebody presses Ctrl-C."""

    def predict(self, release, t_future):
        os.kill(os.getppid(), signal.SIGINT)
        time.sleep(10)


class Swallows(Signals):
    def predict(self, release, t_future):
        try:
            super().predict(release, t_future)
        except BaseException:
            raise ValueError("something went wrong") from None


@dataclass(frozen=True)
class Spoils(KalmanCV):
    """Does to its process what a process does not survive, or not as it was."""

    what: str = "leaves"

    def predict(self, release, t_future):
        if self.what == "leaves" and not is_trial(release):
            os._exit(0)
        os.chdir("/") if self.what == "wanders" else sys.setrecursionlimit(90)
        return super().predict(release, t_future)


class Distant(MovingAverage):
    def fit(self, context):
        usual = super().fit(context)
        far = lambda release: Reconstruction(release.xy + 2 * ESTIMATE_LIMIT_M)
        # Half of the people are attacked at once.
        return lambda release: usual(release) if len(release) <= 6 else far(release)


class AtOnce(KalmanCV):
    def predict(self, release, t_future):
        return ERRORS["torn"].missing


class Counts(KalmanCV):
    def predict(self, release, t_future):
        with open(os.path.join(os.path.dirname(__file__), "calls"), "a") as file:
            print(len(release), file=file)
        return super().predict(release, t_future)


class Dies(KalmanCV):
    def predict(self, release, t_future):
        os._exit(0)


class Hangs(KalmanCV):
    def predict(self, release, t_future):
        time.sleep(100)


class Nothing(Shared):
    def share(self, sensed, rng):
        return None


class Learns(MovingAverage):
    def fit(self, context):
        return np.linalg.inv(np.zeros((2, 2)))
'''
AT_ONCE = {
    # Axis and class: what is told of it before the run, and the words of its line.
    "predictor AtOnce": ("failed: AttributeError: ", 'ERRORS["torn"].missing'),
    "predictor Dies": ("its worker died", "class Dies"),
    "predictor Hangs": ("it ran for longer than 3 s", "class Hangs"),
    "mechanism Nothing": ("must return a Release, got NoneType", "class Nothing"),
    "attack Learns": ("failed: LinAlgError: Singular matrix", "np.linalg.inv"),
}
MECHANISMS = {
    # SPEC without the module: why it is left out
    "Shared:0.5,sigma_m=100000000000": "declared a sigma above 1e+10 m, the limit",
    "Shared:0.5,sigma_m=0": (
        "declared no sigma: a standard deviation for every sample, in m"
    ),
    "Shared:0.5,sigma_m=-0.1": "declared a sigma below 0 or NaN",
    "Shared:0.5,east_m=1e+250": (
        "shared a position that is not within 1e+10 m of the origin"
    ),
    "Wrong:0.5,what=later": (
        "shared a position that is not within 1e+10 m of the origin"
    ),
    "Wrong:0.5": "must return a Release, got NoneType",
    "Wrong:0.5,what=mutates": "failed: ValueError: assignment destination is read-only",
    "Wrong:0.5,what=retimes": "changed the tracks or their times: ",
}
PREDICTORS = {
    "Predicted:xx=-1": (
        "failed: ValueError: a predicted covariance is not positive semidefinite"
    ),
    "Predicted:east_m=1e+13": (
        "failed: ValueError: a predicted position lies beyond 1e+12 m"
    ),
    "Fails": r"failed: ValueError: half a pair \udcff and \x1b[31mred",
    "Fails:what=lengthy": "failed: ValueError: one two all work and no play all work",
    "Fails:what=leaves": "failed: SystemExit: 0",
    "Fails:what=interrupts": "failed: KeyboardInterrupt",
}
ATTACKS = {
    "Distant": "failed: ValueError: a reconstructed position lies beyond 1e+12 m"
}
ALONE = ("--attack", "none", "--task", "none", "--jobs", 1)
"""As few cells as there can be."""
GOOD = (
    "--task",
    "rerelease",
    "--mechanism",
    "fixed:0.7",
    "--predictor",
    "kalman_cv",
    "--attack",
    "moving_average",
    "--attack",
    "shape",
    "--set",
    "conflict.decision=probability",
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """So many people that no operating point is refused."""
    path = tmp_path_factory.mktemp("odd") / "walkers.csv"
    write_csv(path, walkers(150))
    return path


@pytest.fixture
def arguments(recording, tmp_path, monkeypatch):
    """The words of a command; workers have the plug-ins' module as well."""
    (tmp_path / "odd.py").write_text(PLUGINS, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    words = ["--dataset", recording, "--preset", "smoke", "--scenes", 8]
    yield lambda *options: [str(word) for word in (*words, *options)]
    sys.modules.pop("odd", None)


def named(**axes):
    return [f"--{axis}=odd:{spec}" for axis, specs in axes.items() for spec in specs]


FAR_M = f"{0.99 * SHARED_LIMIT_M:g}"
EDGE = named(
    mechanism=[f"Shared:east_m={FAR_M},sigma_m={FAR_M}"],
    predictor=[
        f"Predicted:east_m={0.9 * ESTIMATE_LIMIT_M:g}",
        "Predicted:xx=1e24,yy=0",
    ],
)


def rows(out):
    """What everybody's plug-ins come to at fixed noise."""
    table = pd.read_csv(out / "summary.csv", dtype=str, keep_default_na=False)
    own = (table["mechanism"] == "fixed") & ~table["consumer"].str.startswith("odd:")
    return set(table[own].itertuples(index=False, name=None))


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_each_fails_alone_by_name_and_on_one_line(tmp_path, arguments, capsys, jobs):
    assert matrix.main(arguments("--out", tmp_path / "good", *GOOD, "--jobs", 1)) == 0
    bad = named(
        mechanism=[*MECHANISMS, "Strange"], predictor=PREDICTORS, attack=ATTACKS
    )
    options = ("--out", tmp_path / "all", *GOOD, *EDGE, *bad, "--jobs", jobs)
    assert matrix.main(arguments(*options)) == 3
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    table = pd.read_csv(tmp_path / "all" / "failed.csv", keep_default_na=False)
    for spec, why in MECHANISMS.items():
        own = table[table["spec"] == f"odd:{spec}"]
        assert set(own["kind"]) >= {"shared", "predictor", "attack", "linkage"}, spec
        assert own["why"].str.startswith(f"mechanism 'odd:{spec}' {why}").all()
    at_fixed = table[table["spec"] == "fixed:0.7"]
    message = dict(zip(at_fixed["consumer"], at_fixed["why"], strict=True))
    assert len(message) == len(PREDICTORS) + len(ATTACKS)
    for spec, why in (PREDICTORS | ATTACKS).items():
        line = message[f"odd:{spec}"]
        assert f"odd:{spec}" in line
        assert line.startswith(("predictor ", "attack "))
        assert f" {why}" in line
        assert len(line) < 400
        assert line.isprintable()
    assert rows(tmp_path / "all") == rows(tmp_path / "good")
    assert rows(tmp_path / "good")
    # A fault of our own takes no other cells along and is not hidden.
    ours = table[
        (table["spec"] == "odd:Strange:0.5") & ~table["consumer"].str.startswith("odd:")
    ]
    assert set(ours["consumer"]) == {"moving_average", "bound"}
    (why,) = set(ours["why"])
    assert "KeyError: 'nobody expected this'" in why
    assert "(in isac-track's own code, evaluation.compute.walk_bounds, line " in why
    assert why.endswith(": please report this)")
    shown = (tmp_path / "all" / "tables.txt").read_text(encoding="utf-8")
    assert "please report this" in " ".join(shown.split())
    # What lies at the limits is computed: nothing overflows up to there.
    summary = pd.read_csv(tmp_path / "all" / "summary.csv")
    at_edge = summary["mechanism"].str.startswith("odd:Shared:east_m")
    computed = set(summary[at_edge]["consumer"])
    assert {"shared", "kalman_cv", "moving_average", "rerelease/shape"} <= computed
    assert sum(name.startswith("odd:Predicted") for name in computed) == 2
    # Too few people for these, or no calibration.
    refused = [
        "cllr",
        "rank1_g100",
        "tpr_at_fpr_1pct",
        "tpr_at_fpr_01pct",
        "plr_worst_tenth",
    ]
    own = summary[at_edge & ~summary["metric"].isin(refused)]
    assert np.isfinite(own["value"]).all()
    ends = own[["ci_low", "ci_high"]].to_numpy()
    assert (np.isfinite(ends) | np.isnan(ends)).all()  # of so few people many have none
    assert np.isfinite(ends).any()


@pytest.mark.parametrize("name", ["Signals", "Swallows"])
def test_a_ctrl_c_while_a_plugin_runs_is_the_users(tmp_path, arguments, capsys, name):
    """Even where the plug-in computes the last cell and makes another error of it."""
    options = (
        "--out",
        tmp_path / "run",
        "--mechanism",
        "raw",
        *named(predictor=[name]),
    )
    assert matrix.main(arguments(*options, *ALONE)) == 130
    assert "interrupted; finished cells stay" in capsys.readouterr().err


def test_a_ctrl_c_that_python_cannot_raise_is_heard_and_told_in_one_line(capsys):
    class Ends:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0)  # the signal is handled here, where nothing can be raised

    def command():
        Ends()
        check_interrupt()
        return 0

    assert exit_code(command) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_what_spoils_its_process_spoils_no_run(
    tmp_path, arguments, capsys, monkeypatch
):
    """Even with one job a stranger's plug-in is in a process of its own."""
    monkeypatch.chdir(tmp_path)
    limit = sys.getrecursionlimit()
    odd = named(predictor=["Spoils:what=wanders", "Spoils:what=recurses", "Spoils"])
    odd += ["--set", "conflict.horizons_s=none"]
    assert (
        matrix.main(arguments("--out", "run", "--mechanism", "raw", *odd, *ALONE)) == 3
    )
    failed = pd.read_csv(tmp_path / "run" / "failed.csv").set_index("consumer")["why"]
    assert "its worker died" in failed["odd:Spoils"]
    assert "odd:Spoils:what=wanders" not in failed
    assert (tmp_path / "run" / "verdict.json").is_file()
    assert "Traceback" not in capsys.readouterr().err
    assert sys.getrecursionlimit() == limit


def test_without_a_command_nobody_knows_whose_ctrl_c_it_was():
    """From Python, Ctrl-C is whatever raises KeyboardInterrupt: it gets through."""

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        guarded("mine", interrupted)


@pytest.mark.usefixtures("single_process")
def test_where_nothing_is_left_the_reason_is_one_line(tmp_path, arguments, capsys):
    options = ("--out", tmp_path / "run", "--predictor", "none", *ALONE)
    assert (
        matrix.main(arguments(*options, *named(mechanism=["Shared:east_m=1e250"]))) == 2
    )
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(
        "error: mechanism 'odd:Shared:0.5,east_m=1e+250' shared a position"
    )
    assert (
        json.loads((tmp_path / "run" / "manifest.json").read_text())["state"]
        == "failed"
    )
    assert not (tmp_path / "run" / "summary.csv").exists()


def tried(arguments, name, out, *options):
    """Run what fails before the run, and nothing else that is a stranger's."""
    axis, plugin = name.split()
    few = ["--mechanism", "raw", "--task", "none", "--jobs", 1, "--out", out, *options]
    others = [
        word
        for item in {"predictor", "attack"} - {axis}
        for word in (f"--{item}", "none")
    ]
    bad = named(**{axis: [plugin]}) + (
        ["--cell-timeout", 3] if plugin == "Hangs" else []
    )
    assert matrix.main(arguments(*few, *others, *bad)) == 2


@pytest.mark.parametrize("name", AT_ONCE)
def test_what_fails_with_anybody_fails_before_the_run(
    tmp_path, arguments, capsys, name
):
    plugin, (says, words), out = name.split()[1], AT_ONCE[name], tmp_path / "run"
    with nullcontext() if plugin in {"Dies", "Hangs"} else single_process():
        tried(arguments, name, out)
    (line,) = [
        splitline
        for splitline in capsys.readouterr().err.splitlines()
        if "error: " in splitline
    ]
    assert f"odd:{plugin}" in line
    assert says in line
    lines = PLUGINS.splitlines()
    at = next(number for number, line in enumerate(lines, start=1) if words in line)
    assert f"(odd.py, line {at + words.startswith('class')})" in line
    assert [item.name for item in out.iterdir()] == ["plugin-error.txt"]
    trace = (out / "plugin-error.txt").read_text()
    assert ("Traceback" in trace) == (plugin not in {"Dies", "Hangs"})


@pytest.mark.usefixtures("single_process")
def test_it_is_in_nobodys_way(tmp_path, arguments):
    """Neither in that of another run in this folder, nor of one that is there."""
    out = tmp_path / "run"
    tried(arguments, "predictor AtOnce", out)
    good = ("--mechanism", "raw", "--predictor", "least_squares", *ALONE, "--out", out)
    assert matrix.main(arguments(*good)) == 0
    before = {item: item.read_bytes() for item in out.rglob("*") if item.is_file()}
    assert out / "plugin-error.txt" not in before
    tried(arguments, "predictor AtOnce", out, "--fresh")
    (out / "plugin-error.txt").unlink()
    assert {
        item: item.read_bytes() for item in out.rglob("*") if item.is_file()
    } == before


@pytest.mark.usefixtures("single_process")
def test_what_is_finished_is_not_tried_again(tmp_path, arguments):
    words = arguments("--out", tmp_path / "run", "--mechanism", "raw", *ALONE)
    words += [*named(predictor=["Counts"]), "--set", "conflict.horizons_s=none"]
    assert matrix.main(words) == 0
    calls = (tmp_path / "calls").read_text()
    assert calls.split() == ["12", "32"]
    assert matrix.main(words) == 0
    assert (tmp_path / "calls").read_text() == calls
