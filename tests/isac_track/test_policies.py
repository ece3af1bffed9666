"""Policies: the samples of an answer against plain loops, names, and bad values."""

import numpy as np
import pytest
from helpers.patrols import SETTINGS, make_network, sent_answers

from isac_track import plugins
from isac_track.errors import PluginError, SettingsError
from isac_track.patrols import make_patrol
from isac_track.patrols.answers import disclose
from isac_track.plugins import parse
from isac_track.policies.query import Query, View
from isac_track.policies.samples import Ahead, Everything, Near, RandomPeople, Window
from isac_track.policies.summaries import Flag, State
from isac_track.protocols import Policy
from isac_track.rng import stream
from isac_track.sharing import Fid
from isac_track.types import Prediction

# Three people, of 4, 2 and 1 samples; the robot walks along x at 1 m/s from (0, 0).
T = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 3.0, 3.0])
OFFSETS = np.array([0, 4, 6, 7])
RAW = np.array(
    [[9.0, 9.0], [9.0, 9.0], [9.0, 9.0], [0.0, 2.0], [5.0, 5.0], [5.0, 5.0], [2.0, 1.0]]
)
SHARED = RAW + np.array([10.0, 0.0])
AHEAD_S = np.array([0.0, 1.0, 2.0])
ROUTE = np.stack([AHEAD_S, np.zeros(3)], axis=1)


def forecast(xy, *, std=None):
    """Forecast that nobody moves; its standard deviation grows by `std` a second."""
    mean = np.repeat(xy[OFFSETS[1:] - 1][:, None], 3, axis=1)
    cov = None
    if std is not None:
        cov = np.tile(np.eye(2), (3, 3, 1, 1)) * (std * AHEAD_S[:, None, None]) ** 2
    return Prediction(mean, cov)


def query(*, std=None, seed=0):
    return Query(
        t=T,
        offsets=OFFSETS,
        raw=View(RAW, forecast(RAW, std=std)),
        shared=View(SHARED, forecast(SHARED, std=std)),
        robot_xy=ROUTE,
        ahead_s=AHEAD_S,
        rng=stream(seed, "test", "query"),
    )


def numbers(policy, **changes):
    """The samples that a policy selects."""
    return np.flatnonzero(policy.select(query(**changes))).tolist()


class TestSelection:
    def test_everything(self):
        assert numbers(Everything()) == [0, 1, 2, 3, 4, 5, 6]

    @pytest.mark.parametrize(
        ("seconds", "selected"),
        [(0.5, [3, 5, 6]), (1.0, [2, 3, 4, 5, 6]), (9.0, list(range(7)))],
    )
    def test_window(self, seconds, selected):
        assert numbers(Window(seconds)) == selected

    @pytest.mark.parametrize(
        ("metres", "selected"),
        [(1.9, []), (2.0, []), (2.1, [2, 3]), (2.3, [2, 3, 6]), (9.0, [2, 3, 4, 5, 6])],
    )
    def test_near_is_strict_and_of_the_last_sample(self, metres, selected):
        assert numbers(Near(metres)) == selected

    def test_near_without_a_window_sends_all_history(self):
        assert numbers(Near(2.1, window_s=None)) == [0, 1, 2, 3]

    def test_near_on_shared_positions(self):
        assert numbers(Near(9.0, select_on="shared")) == []
        assert numbers(Near(10.5, select_on="shared")) == [2, 3]

    # The third person stands 1 m beside the route, where the robot is after 2 s.
    @pytest.mark.parametrize(
        ("margin_m", "horizon_s", "selected"),
        [
            (1.1, 3.0, [6]),
            (1.0, 3.0, []),
            (1.1, 1.9, []),
            (1.5, 1.0, [6]),
            (2.1, 3.0, [2, 3, 6]),
        ],
    )
    def test_ahead_is_of_the_same_instants(self, margin_m, horizon_s, selected):
        assert numbers(Ahead(margin_m, horizon_s=horizon_s)) == selected

    def test_ahead_widens_with_the_uncertainty_of_the_forecast(self):
        assert numbers(Ahead(0.5), std=0.2) == []
        assert numbers(Ahead(0.5, stds=1.0), std=0.2) == []
        assert numbers(Ahead(0.5, stds=1.5), std=0.2) == [6]  # 0.5 m + 1.5 * 0.4 m

    def test_ahead_cannot_widen_without_a_covariance(self):
        with pytest.raises(
            ValueError, match="stds needs a network forecast with a covariance"
        ):
            Ahead(0.5, stds=1.0).select(query())

    def test_state_is_of_the_last_instant_and_flag_of_none(self):
        assert numbers(State()) == [3, 5, 6]
        assert numbers(State(1.1)) == [6]
        assert numbers(Flag()) == []

    def test_random_is_none_all_or_a_share_of_people(self):
        assert numbers(RandomPeople(0.0)) == []
        assert numbers(RandomPeople(1.0)) == [2, 3, 4, 5, 6]
        drawn = [RandomPeople(0.3).select(query(seed=seed))[-1] for seed in range(600)]
        assert np.mean(drawn) == pytest.approx(0.3, abs=0.06)


@pytest.fixture(scope="module")
def crowd(request):
    tracks = request.getfixturevalue("tracks")
    settings = SETTINGS.changed({"patrol.segment_s": 8.0})
    return make_network(make_patrol(tracks, settings=settings, seed=0), Fid(1.0))


def slow_selection(network, robot, presence, *, metres, forecasts, select_on):
    """Whether near or ahead send samples of a person: a plain loop over instants."""
    patrol = network.patrol
    now = patrol.query_scan[patrol.presences.query[presence]]
    xy = (network.sensed if select_on == "raw" else network.release).xy
    places = xy[patrol.presences.sample[presence]][None]
    if forecasts:
        prediction = (
            network.raw_forecast if select_on == "raw" else network.shared_forecast
        )
        places = prediction.mean[presence, : int(3.0 / 0.0836) + 1]
    return any(
        np.hypot(*(place - patrol.robot_xy[robot, now + step])) < metres
        for step, place in enumerate(places)
    )


@pytest.mark.parametrize("select_on", ["raw", "shared"])
@pytest.mark.parametrize(("policy_class", "metres"), [(Near, 3.0), (Ahead, 1.2)])
def test_a_patrol_discloses_what_a_plain_loop_selects(
    crowd, policy_class, metres, select_on
):
    patrol = crowd.patrol
    sent = sent_answers(crowd, policy_class(metres, select_on=select_on))
    assert sent
    for robot in range(patrol.n_robots):
        for presence, sample in enumerate(patrol.presences.sample):
            expected = slow_selection(
                crowd,
                robot,
                presence,
                metres=metres,
                forecasts=policy_class is Ahead,
                select_on=select_on,
            )
            first = max(
                patrol.people.offsets[patrol.presences.person[presence]], sample - 15
            )
            samples = list(range(first, sample + 1)) if expected else None
            assert sent.get((robot, presence)) == samples


def test_everything_discloses_all_history_of_those_present(crowd):
    patrol, sent = crowd.patrol, sent_answers(crowd, Everything())
    assert len(sent) == patrol.n_robots * len(patrol.presences)
    for (_, presence), samples in sent.items():
        first = patrol.people.offsets[patrol.presences.person[presence]]
        assert samples == list(range(first, patrol.presences.sample[presence] + 1))


def test_draws_depend_on_robot_and_query_alone(tracks):
    settings = SETTINGS.changed({"patrol.segment_s": 8.0})
    answers = []
    for fleets in (1, 3):
        changed = settings.changed({"patrol.fleets": fleets})
        network = make_network(make_patrol(tracks, settings=changed, seed=0))
        disclose(network, RandomPeople(0.9))
        answers.append(sent_answers(network, RandomPeople(0.3)))
    few, many = answers
    assert few == {key: sent for key, sent in many.items() if key[0] == 0}
    ours, theirs = ({key[1] for key in many if key[0] == robot} for robot in (0, 1))
    assert ours != theirs


class TestPlugins:
    def test_every_policy_is_known_by_its_name(self):
        named = {
            "everything": Everything(),
            "window:1.3": Window(1.3),
            "near:4.5": Near(4.5),
            "ahead:1.2": Ahead(1.2),
            "state": State(),
            "flag": Flag(),
            "random:0.2": RandomPeople(0.2),
        }
        assert {spec.partition(":")[0] for spec in named} == set(
            plugins.names("policies")
        )
        for spec, policy in named.items():
            (plugin,) = parse("policies", spec)
            assert (plugin.instance, plugin.spec) == (policy, spec)
            assert isinstance(policy, Policy)
            assert plugins.resolve_plugins("policies", policy)[0].spec == spec

    def test_parameters_stay_in_the_name(self):
        (plugin,) = parse("policies", "near:4.5,window_s=none,select_on=shared")
        assert plugin.instance == Near(4.5, None, "shared")
        assert plugin.name == "near:window_s=None,select_on=shared"
        assert plugin.level == 4.5
        assert parse("policies", plugin.spec) == (plugin,)

    def test_a_sweep_is_several_levels(self):
        levels = [plugin.spec for plugin in parse("policies", "ahead:1..2/3")]
        assert levels == ["ahead:1", "ahead:1.5", "ahead:2"]

    @pytest.mark.parametrize(
        ("spec", "message"),
        [
            ("window:0", "seconds must be positive, got 0"),
            ("window", "window needs a value for seconds"),
            ("near:-1", "metres must be positive, got -1"),
            ("near:2,window_s=0", "window_s must be positive, got 0"),
            ("ahead:1,horizon_s=0", "horizon_s must be positive"),
            ("ahead:1,stds=-1", "stds must be 0 or more"),
            ("random:1.5", "share must lie within 0 to 1, got 1.5"),
            ("state:0", "metres must be positive"),
            ("flag:raw,select_on=raw", "select_on is given twice"),
            ("near:1,select_on=truth", "select_on must be one of raw, shared"),
            ("nearr:1", "unknown policy 'nearr'; did you mean 'near'"),
        ],
    )
    def test_a_wrong_value_is_one_clear_error(self, spec, message):
        with pytest.raises(SettingsError, match=message):
            parse("policies", spec)

    def test_a_policy_declares_the_form_of_its_answers(self):
        with pytest.raises(
            PluginError, match="form must be one of samples, state, flag"
        ):
            plugins.check_declared("policies", Fid(1.0), "mine:Policy")

    @pytest.mark.parametrize(
        "selected", [np.ones(3, dtype=bool), np.arange(7), None, "everybody"]
    )
    def test_a_policy_that_returns_no_mask_is_named(self, crowd, selected):
        class Broken:
            form = "samples"

            def select(self, query):
                del query
                return selected

        with pytest.raises(PluginError, match="policy broken must return a mask of"):
            disclose(crowd, Broken(), name="broken")

    def test_a_policy_that_raises_is_named(self, crowd):
        class Raising:
            form = "samples"

            def select(self, query):
                raise ZeroDivisionError(query.n_people)

        with pytest.raises(
            PluginError, match="policy Raising failed: ZeroDivisionError"
        ):
            disclose(crowd, Raising())
