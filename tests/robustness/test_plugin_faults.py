"""All that a stranger's predictor can do to a run, in one run: each fails by name."""

import pandas as pd
import pytest
from helpers.commands import FEW, MATRIX, UNDRAWN, assert_refused, run
from helpers.processes import ROOT
from helpers.small_runs import write_walks

pytestmark = pytest.mark.slow

LIMIT_S = 6
DIED, SLOW = "its worker died", f"it ran for longer than {LIMIT_S} s"
FAR, COVARIANCE = (
    f"failed: ValueError: a predicted {item}" for item in ("position", "covariance")
)
FAULTS = {
    # What it returns, given the mean (2D arrays by track) and the release: why it is
    # left out.
    "raises": ("raises(KeyError('no idea'))", "failed: KeyError: 'no idea'"),
    "raises lines": (
        r"raises(ValueError('one\ntwo\x1b[31m' * 9**6))",
        "ValueError: one two",
    ),
    "raises silently": ("raises(Silent())", "failed: Silent"),
    "closes": ("raises(GeneratorExit())", "failed: GeneratorExit"),
    "stops": ("raises(StopIteration())", "failed: StopIteration"),
    "goes deeper": ("deeper()", "failed: RecursionError"),
    "wants memory": ("np.empty(10**15)", "failed: "),
    "imports": (
        "__import__('not_there')",
        "ModuleNotFoundError: No module named 'not_there'",
    ),
    "exits with 0": ("os._exit(0)", DIED),
    "exits with 3": ("os._exit(3)", DIED),
    "kills itself": ("os.kill(os.getpid(), signal.SIGKILL)", DIED),
    "crashes": ("os.kill(os.getpid(), signal.SIGSEGV)", DIED),
    "aborts": ("os.abort()", DIED),
    "sleeps": ("time.sleep(3600)", SLOW),
    "holds on": ("re.match('(a+)+$', 64 * 'a' + 'b')", SLOW),
    "returns nothing": ("None", "must return a Prediction"),
    "returns numbers": ("mean", "must return a Prediction"),
    "not a number": ("Prediction(mean * np.nan)", FAR),
    "infinite": ("Prediction(mean + np.inf)", FAR),
    "peeks": ("Prediction(mean + release.sigma.max())", "failed: AttributeError"),
    "too few": ("Prediction(mean[1:])", "must return a Prediction with mean"),
    "turned over": ("Prediction(mean.T)", "failed: ValueError: mean must have shape"),
    "complex": ("Prediction(mean + 0j)", "failed: "),
    "masked": ("Prediction(np.ma.masked_array(mean, mean > 0))", "failed: "),
    "words": ("Prediction(np.full(mean.shape, 'west'))", "failed: "),
    "objects": ("Prediction(np.full(mean.shape, None))", "failed: "),
    "skewed": ("covariance(mean, [[1.0, 1.0], [0.0, 1.0]])", COVARIANCE),
}
HARMLESS = {
    "moves": "os.chdir('/')",
    "lowers the ceiling": "sys.setrecursionlimit(60)",
    "seeds": "np.random.seed(0), random.seed(0)",
    "talks": "print('x' * 10**5), print('y', file=sys.stderr)",
    "shuts its mouth": "os.close(1), os.close(2)",
    "warns": "warnings.warn('careful')",
    "forgets": "os.environ.clear()",
    "works on": "threading.Thread(target=time.sleep, args=(9,), daemon=True).start()",
    "counts otherwise": "np.seterr(all='raise')",
    "writes into it": "release.xy.setflags(write=True), release.xy.fill(0.0)",
    "hears nothing": "signal.signal(signal.SIGINT, signal.SIG_IGN)",
    "dies once": "is_second() or os._exit(1)",
}


def table(calls):
    return "".join(
        f"{name!r}: lambda mean, release: ({call}),\n" for name, call in calls.items()
    )


PLUGINS = f"""
import os, random, re, signal, sys, threading, time, warnings
from dataclasses import dataclass

import numpy as np

from attacks.linkage.alignment import Shape
from isac_track.sharing import Fixed
from isac_track.types import Prediction
from predictors.least_squares import LeastSquares


class Silent(Exception):
    def __str__(self):
        raise RuntimeError("not even that")


def raises(error):
    raise error


def deeper():
    return deeper() + 1


def is_second():
    # Whether this was asked before, by anybody.
    path = os.path.join(os.path.dirname(__file__), "asked")
    return os.path.exists(path) or open(path, "w").close()


def covariance(mean, cov):
    return Prediction(mean, np.broadcast_to(np.array(cov), (*mean.shape, 2)))


FAULTS = {{{table({name: call for name, (call, _) in FAULTS.items()})}}}
HARMLESS = {{{table(HARMLESS)}}}


@dataclass(frozen=True)
class Odd(LeastSquares):
    what: str = "nothing"

    def predict(self, release, t_future):
        usual = super(Odd, self).predict(release, t_future)
        if len(release) == 12:  # as it is called before the run
            return usual
        if self.what in FAULTS:
            return FAULTS[self.what](np.array(usual.mean), release)
        HARMLESS[self.what](usual.mean, release)
        return usual


class Hangs(Fixed):
    def share(self, sensed, rng):
        return super().share(sensed, rng) if len(sensed) == 12 else time.sleep(3600)


class Leaves(Shape):
    def fit(self, context):
        usual = super().fit(context)
        return lambda *both: usual(*both) if len(both[0]) == 12 else os._exit(9)

"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugin-faults")
    write_walks(folder / "walks.csv", n_people=24)
    (folder / "odd.py").write_text(PLUGINS, encoding="utf-8")
    return folder


def matrix(place, *options, command=UNDRAWN, **how):
    return run(
        place, *command, *FEW, "--scenes", 8, "--dataset", "walks.csv", *options, **how
    )


@pytest.fixture(scope="module")
def ended(place):
    """One run with everything in it, and its folder, named from its starting point."""
    named = [f"--predictor=odd:Odd:what={name}" for name in (*FAULTS, *HARMLESS)]
    limits = ("--cell-timeout", LIMIT_S, "--jobs", 2, "--out", "all")
    result = matrix(place, *named, *limits, command=MATRIX, timeout_s=900)
    assert matrix(place, "--jobs", 1, "--out", "usual").code == 0
    return result, place / "all"


def rows(out, consumer):
    csv = pd.read_csv(out / "summary.csv", dtype=str, keep_default_na=False)
    return csv[csv["consumer"] == consumer].drop(columns="consumer").to_csv(index=False)


def test_the_run_goes_on_and_says_so(ended):
    summary, out = ended
    assert summary.code == 3, summary
    assert (out / "report.html").exists()
    assert {item.name for item in out.parent.iterdir()} >= {
        "all",
        "odd.py",
        "usual",
        "walks.csv",
    }
    failed = pd.read_csv(out / "failed.csv")
    assert {item.partition("what=")[2] for item in failed["consumer"]} == set(FAULTS)


@pytest.mark.parametrize("name", FAULTS)
def test_that_fails_alone_and_by_name(name, ended):
    _, out = ended
    failed = pd.read_csv(out / "failed.csv")
    own = failed[failed["consumer"] == f"odd:Odd:what={name}"]
    assert set(own["spec"]) == {"raw", "fixed:0.7"}
    for why in own["why"]:
        assert FAULTS[name][1] in why
        assert len(why) < 400
        assert why.isprintable()
    assert rows(out, f"odd:Odd:what={name}").count("\n") == 1


@pytest.mark.parametrize("name", ["least_squares", "shared", *HARMLESS])
def test_that_all_others_are_as_without_it(name, ended):
    _, out = ended
    consumer = f"odd:Odd:what={name}" if name in HARMLESS else name
    usual = "shared" if name == "shared" else "least_squares"
    assert rows(out, consumer) == rows(out.parent / "usual", usual)


def test_so_do_a_mechanism_and_a_linker_and_take_nobody_along(place):
    linked = (
        *FEW[:4],
        *FEW[8:],  # without its own choice of attacks and tasks
        "--scenes",
        8,
        "--dataset",
        "walks.csv",
        "--attack",
        "shape",
    )
    linked += ("--task", "rerelease", "--cell-timeout", 3, "--jobs", 2, "--out")
    odd = ("--mechanism", "odd:Hangs:0.5", "--attack", "odd:Leaves")
    assert run(place, *UNDRAWN, *linked, "odd", *odd).code == 3
    failed = pd.read_csv(place / "odd" / "failed.csv").groupby("spec")["why"].agg(set)
    assert failed.pop("odd:Hangs:0.5") == {"it ran for longer than 3 s"}
    assert set(failed.index) == {"raw", "fixed:0.7", "clean"}
    assert all(DIED in why for reasons in failed for why in reasons)
    assert run(place, *UNDRAWN, *linked, "linked").code == 0
    usual = pd.read_csv(
        place / "linked" / "summary.csv", dtype=str, keep_default_na=False
    )
    csv = pd.read_csv(place / "odd" / "summary.csv", dtype=str, keep_default_na=False)
    pd.testing.assert_frame_equal(csv[usual.columns], usual)


NAMED_WRONGLY = {
    "odd:Nothing": "Nothing",
    "broken:Odd": "SyntaxError",
    "raising:Odd": "no luck today",
    "leaving:Odd": "SystemExit",
}


@pytest.mark.parametrize("spec", NAMED_WRONGLY)
def test_what_cannot_be_had_is_one_line_before_anything_is_begun(spec, place, tmp_path):
    (tmp_path / "broken.py").write_text("def predict(:")
    (tmp_path / "raising.py").write_text("raise OSError('no luck today')")
    (tmp_path / "leaving.py").write_text("import sys; sys.exit(0)")
    path = {"PYTHONPATH": f"{tmp_path}:{ROOT}"}
    ended = matrix(place, "--predictor", spec, "--out", tmp_path / "run", changed=path)
    assert_refused(ended, NAMED_WRONGLY[spec])
    assert not (tmp_path / "run").exists()
