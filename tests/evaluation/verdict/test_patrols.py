"""The policy that is proposed for patrols, from numbers that one can check by hand."""

import numpy as np
import pytest

from evaluation.estimates.families import Family
from evaluation.estimates.patrols import PatrolNumber
from evaluation.plan.address import Address
from evaluation.plan.world import World
from evaluation.verdict.patrol_json import proposal_json, read_proposal
from evaluation.verdict.patrol_records import USUAL_LIMITS, PatrolLimits
from evaluation.verdict.patrols import choose_policy, farthest_horizon, patrol_options
from isac_track.errors import SettingsError
from isac_track.intervals import Estimate

FAMILIES = {
    "raw": Family("raw", "raw", "", protects=False),
    "fid": Family("fid", "fid", "linear"),
    "offset": Family("offset", "offset", "", protects=False),
}


def numbers(options, *, robot="kalman_cv", horizon_s=3.0, half=None):
    """Missed futures, known and followed shares by (mechanism, policy)."""
    made = []
    for (mechanism, policy), (missed, known) in options.items():
        replicates = np.zeros(0)
        ends = (np.nan, np.nan)
        if half is not None:
            replicates = missed + half * np.linspace(-1.0, 1.0, 201)
            # The misses of another policy than the paper's vary the other way.
            replicates = replicates[::-1] if policy != "everything" else replicates
            ends = (missed - half, missed + half)
        address = Address(
            world=World(horizon_s=horizon_s),
            mechanism=mechanism,
            policy=policy,
            plugin=robot,
            metric="missed_future_at_equal_false_alarms",
        )
        is_control = policy in ("everything", "random:0.2")
        lost = Estimate(missed, *ends, 30, replicates)
        made.append(PatrolNumber(address, lost, claims_protection=not is_control))
        for adversary, metric, share in (
            ("blind", "known_share", known),
            ("informed", "known_share", known - 0.01),
            ("oracle", "known_share", known + 0.04),
            ("blind", "followed_10s", known / 10),
        ):
            log = Address(
                mechanism=mechanism,
                policy=policy,
                plugin="log",
                adversary=adversary,
                metric=metric,
            )
            made.append(PatrolNumber(log, Estimate(share, n=40)))
    return made


OPTIONS = {
    ("raw", "everything"): (0.30, 0.95),
    ("raw", "state:2"): (0.33, 0.20),
    ("fid", "state:2"): (0.40, 0.10),
    ("raw", "near:3"): (0.34, 0.30),
}


def chosen(made, limits=USUAL_LIMITS, **asked):
    options = patrol_options(made, families=FAMILIES)
    asked = {"horizon_s": farthest_horizon(options)} | asked
    return choose_policy(options, limits, **asked)


def test_least_is_known_within_the_limit():
    result = chosen(numbers(OPTIONS))
    assert result.is_within
    assert (result.option.mechanism, result.option.policy) == ("raw", "state:2")
    assert result.option.known.value == 0.20  # The stronger one without identities.
    assert result.option.lost.value == pytest.approx(0.03)
    assert result.everything.known.value == 0.95
    assert not result.has_interval


def test_an_adversary_without_a_number_hides_no_other():
    made = numbers(OPTIONS)
    unknown = [
        number._replace(estimate=Estimate(np.nan))
        if number.address.adversary == "blind"
        else number
        for number in made
    ]
    best = chosen(unknown).option
    assert (best.policy, best.known.value) == ("state:2", pytest.approx(0.19))


def test_with_intervals_the_upper_end_of_the_loss_counts():
    # The paired loss of state:2 is 3 points +- 4: too much for a limit of 5.
    result = chosen(numbers(OPTIONS, half=0.02))
    assert result.option.policy == "everything"
    narrow = chosen(numbers(OPTIONS, half=0.005))
    assert narrow.option.policy == "state:2"
    assert narrow.option.lost.ci_high == pytest.approx(0.04, abs=0.001)


@pytest.mark.parametrize(
    ("limits", "best"),
    [
        ({"missed": 0.5}, ("fid", "state:2")),
        ({"missed": 0.35}, ("raw", "state:2")),
        ({"missed": 0.31}, ("raw", "everything")),
        ({"missed": 0.5, "known": 0.15}, ("fid", "state:2")),
        ({"missed": 0.31, "known": 0.15}, None),
        ({"missed": 0.35, "followed": 0.021}, ("raw", "state:2")),
        ({"missed": 0.35, "followed": 0.01}, None),
        ({}, ("fid", "state:2")),
    ],
)
def test_every_limit_that_is_asked_holds(limits, best):
    result = chosen(numbers(OPTIONS), PatrolLimits(**{"lost": None} | limits))
    option = result.option
    assert result.is_within == (best is not None)
    assert best in {None, (option.mechanism, option.policy)}


def test_the_nearest_exceeds_fewest_limits_by_least():
    limits = PatrolLimits(lost=None, missed=0.31, known=0.15)
    result = chosen(numbers(OPTIONS, half=0.005), limits)
    assert not result.is_within
    # Two points of misses and five of knowledge, or nine and none.
    assert (result.option.mechanism, result.option.policy) == ("fid", "state:2")
    assert result.option.exceeded(limits) == {"missed": pytest.approx(0.405)}


def test_a_control_is_never_proposed():
    controls = {("offset", "state:2"): (0.3, 0.01), ("raw", "random:0.2"): (0.3, 0.01)}
    result = chosen(numbers(OPTIONS | controls))
    assert (result.option.mechanism, result.option.policy) == ("raw", "state:2")


def test_the_robot_that_misses_least_is_served_unless_one_is_named():
    worse = {
        option: (missed + 0.2, known) for option, (missed, known) in OPTIONS.items()
    }
    both = numbers(worse, robot="constant_position") + numbers(OPTIONS)
    assert chosen(both).robot == "kalman_cv"
    assert chosen(both, robot="constant_position").robot == "constant_position"
    assert chosen(both, robot="unknown") is None


def test_the_farthest_horizon_counts():
    near = numbers(dict.fromkeys(OPTIONS, (0.0, 0.5)), horizon_s=None)
    result = chosen(near + numbers(OPTIONS))
    assert result.horizon_s == 3.0
    assert result.option.lost.value == pytest.approx(0.03)


def test_without_the_reference_nothing_is_proposed():
    assert chosen([]) is None
    assert chosen(numbers({("raw", "near:3"): (0.3, 0.2)})) is None


@pytest.mark.parametrize("half", [None, 0.02])
@pytest.mark.parametrize("known", [None, 0.05])
def test_a_proposal_is_read_as_it_was_written(half, known):
    limits = PatrolLimits(known=known)
    content = proposal_json(chosen(numbers(OPTIONS, half=half), limits))
    assert (content["best"] is None) == (known is not None)
    assert proposal_json(read_proposal({"recommended": content})) == content
    assert read_proposal({}) is None


def test_a_limit_is_a_fraction():
    with pytest.raises(SettingsError, match=r"--max-known is a fraction .* got 20"):
        PatrolLimits(known=20.0)
