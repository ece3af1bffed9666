"""The decision on people who come back, as data, and its sentence."""

import pytest

from evaluation.estimates.returns import ReturnNumbers
from evaluation.plan.address import Address
from evaluation.reporting.amounts import fine_interval, fine_share
from evaluation.verdict.returns import read_return, return_answer, return_json
from isac_track.intervals import Estimate

GAIN = Estimate(0.3, 0.2, 0.4, n=30)
NONE = Estimate(-0.1, -0.2, 0.02, n=30)
CONFIRMED = {"confirming_gain": Estimate(0.2, n=12), "confirming_p": Estimate(0.01)}


def numbers(gain, p_value, *, mechanism="clean", **further):
    """The numbers of the level that decides, by metric of the fusion."""
    values = {
        "rank1": Estimate(0.4, 0.3, 0.5, n=30),
        "chance": Estimate(0.04, n=30),
        "rank1_gain": gain,
        "nested_p": Estimate(p_value, n=30),
        **further,
    }
    addresses = {("fusion", name): value for name, value in values.items()}
    addresses["control-strongest", "rank1"] = Estimate(0.1, 0.05, 0.2, n=30)
    estimates = {
        Address(mechanism=mechanism, task="returns", plugin=plugin, metric=name): value
        for (plugin, name), value in addresses.items()
    }
    chosen = {
        Address(mechanism=mechanism, task="returns", plugin=f"control-{name}"): n
        for name, n in (("speed", 4), ("neighbours", 26), ("length", 0))
    }
    return ReturnNumbers(estimates, chosen)


@pytest.mark.parametrize(
    ("decision", "gain", "p_value", "further"),
    [
        ("yes", GAIN, 0.001, CONFIRMED),
        ("not decided", GAIN, 0.001, {}),
        ("not decided", GAIN, 0.02, CONFIRMED),
        ("not decided", GAIN, 0.001, CONFIRMED | {"confirming_p": Estimate(0.2)}),
        ("no", NONE, 0.001, {}),
        ("not decided", Estimate(0.3, 0.2, 0.4, n=19), 0.001, CONFIRMED),
    ],
)
def test_the_rule_decides_on_the_level_without_error(decision, gain, p_value, further):
    answer = return_answer(numbers(gain, p_value, **further), confirming="run 4")
    assert answer.decision == decision
    assert answer.n == gain.n
    assert answer.nested_p == p_value
    assert answer.confirming == "run 4"
    assert answer.confirming_p == (further["confirming_p"].value if further else None)
    assert list(answer.controls.items()) == [("neighbours", 26), ("speed", 4)]
    assert answer.control.value == 0.1
    content = return_json(answer)
    assert return_json(read_return({"returns": content})) == content


def test_other_levels_decide_nothing():
    assert return_answer(numbers(GAIN, 0.001, mechanism="raw")) is None
    assert return_answer(ReturnNumbers()) is None
    assert read_return({}) is None


def test_shares_have_a_digit_only_below_a_percent():
    assert fine_share(0.336) == "34"
    assert fine_share(0.0046) == "0.5"
    assert fine_share(0.0001) == fine_share(0.0) == fine_share(-0.0001) == "0"
    assert fine_share(None) == fine_share(float("nan")) == "?"
    assert fine_interval(0.02, 0.005, 0.08) == "2 % [0.5, 8]"
    assert fine_interval(0.02, None, 0.08) == "2 %"
