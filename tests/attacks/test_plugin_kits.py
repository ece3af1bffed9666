"""The kits for mechanisms and predictors: what is built in passes, each mistake fails its check."""

import re

import numpy as np
import pytest
from helpers import broken_plugins
from helpers.broken_plugins import BROKEN, Noise, Stand, plugin

from attacks.testing import (
    MECHANISM_CHECKS,
    PREDICTOR_CHECKS,
    checks_for,
    parametrize_mechanism_checks,
    parametrize_predictor_checks,
    run_checks,
)
from isac_track import plugins
from isac_track.errors import PluginError, SettingsError
from isac_track.types import Knowledge

MECHANISMS = [
    plugins.parse("mechanisms", spec)[0].instance
    for spec in (
        *("raw", "clean", "offset:0.3", "thin:3", "thin:3,d_sigma=0.5,adding=independent"),
        *("fixed:0", "fixed:0.5", "fixed:0.5,adding=independent", "fixed:0,adding=independent"),
        *("fixed:0.5,adding=independent,law=isotropic", "fid:100", "fid:1000,adding=independent"),
        *("correlated:0.5", "correlated:0.5,tau_s=9,adding=independent"),
    )
]
PREDICTORS = [
    plugins.parse("predictors", name)[0].instance
    for name, origin in plugins.names("predictors").items()
    if origin.startswith("predictors.")
]


@parametrize_mechanism_checks([*MECHANISMS, Noise()])
def test_a_fair_mechanism_passes(mechanism, check):
    check(mechanism)


@parametrize_predictor_checks([*PREDICTORS, Stand()])
def test_a_fair_predictor_passes(predictor, check):
    check(predictor)


def test_everything_built_in_is_among_them():
    built_in = set(plugins.names("mechanisms"))
    assert {type(one).__name__.lower() for one in MECHANISMS} == built_in
    assert len(PREDICTORS) >= 5


@pytest.mark.parametrize(
    ("broken", "name", "message"),
    [pytest.param(*case, id=f"{case[0].__name__}-{case[1]}") for case in BROKEN],
)
def test_a_mistake_fails_the_one_check_about_it(broken, name, message):
    failed = [result for result in run_checks(plugin(broken)) if result.status == "failed"]
    assert [result.name for result in failed] == [name]
    assert re.search(f"^{broken.__name__}: .*{message}", failed[0].message)


def test_every_check_catches_a_mistake():
    assert {name for _, name, _ in BROKEN} == MECHANISM_CHECKS.keys() | PREDICTOR_CHECKS.keys()


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda sensed, rng: Noise().share(sensed, rng).tracks([0]), "of 24 tracks it returned 1"),
        (lambda sensed, _rng: sensed.xy, "share must return a Release, got ndarray"),
        (lambda _release, _t_future: np.zeros((1, 2)), "must return a Prediction, got ndarray"),
        (broken_plugins.skewed, "a predicted covariance is not symmetric"),
    ],
)
def test_what_spoils_every_run_ends_no_check(made, message):
    results = run_checks(plugin(made))
    assert len(results) == len(checks_for(plugin(made)))
    assert results[0].status == "failed"
    assert message in results[0].message


def test_sigma_is_there_for_who_requires_it():
    requires = {"requires": frozenset({Knowledge.SIGMA})}
    asks = type("Asks", (type(plugin(broken_plugins.takes_sigma)),), requires)()
    assert all(result.passed for result in run_checks(asks))


class TestUsage:
    def test_a_wrong_name_is_answered_with_the_nearest(self):
        with pytest.raises(SettingsError, match="of a mechanism; did you mean 'sigma_is_declared'"):
            run_checks(Noise(), names=["sigma_is_declarde"])

    @pytest.mark.parametrize(
        ("call", "message"),
        [
            (lambda: checks_for(Noise), r"got its class: write Noise\(\)"),
            (
                lambda: checks_for(type("Soft", (), {"share": print})()),
                "mechanism Soft must be a f",
            ),
            (lambda: parametrize_mechanism_checks([Stand()]), "Stand is no mechanism, but a pred"),
            (lambda: parametrize_predictor_checks(Stand()), r"parametrize_predictor_checks\(\["),
        ],
    )
    def test_what_is_no_such_plugin(self, call, message):
        with pytest.raises(PluginError, match=message):
            call()

    def test_checks_state_what_they_show_and_are_in_the_guide(self, pytestconfig):
        guide = (pytestconfig.rootpath / "docs" / "plugins.md").read_text(encoding="utf-8")
        for name, check in (MECHANISM_CHECKS | PREDICTOR_CHECKS).items():
            assert check.statement.endswith(".")
            assert f"`{name}`" in guide
