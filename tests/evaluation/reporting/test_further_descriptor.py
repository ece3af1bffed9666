"""Texts on a privacy descriptor in another unit than the paper's, leaks a minute."""

from types import SimpleNamespace

import pandas as pd
import pytest

from evaluation import design
from evaluation.estimates import metrics
from evaluation.plan.address import parse_consumer
from evaluation.reporting.difference_tables import sign_changes
from evaluation.reporting.recommendation import reason
from evaluation.verdict import question
from evaluation.verdict.number_text import with_interval, without_interval
from evaluation.verdict.offers import Check
from evaluation.verdict.question import Question
from isac_track.errors import SettingsError
from isac_track.intervals import Estimate


@pytest.fixture(params=["1/min", "ratio"])
def leaks_unit(request, monkeypatch):
    """The unit of a descriptor `leaks` that the suite has for the length of a test."""
    leaks = metrics.Metric(
        "leaks", "leaks a minute", "descriptor", "Leaks.", summary_unit=request.param
    )
    monkeypatch.setitem(metrics.METRICS, "leaks", leaks)
    monkeypatch.setitem(question.LIMITS, "leaks", "leaks")
    monkeypatch.setattr(metrics, "DESCRIPTORS", (*metrics.DESCRIPTORS, "leaks"))
    return leaks.unit


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("1/min", "3.00 1/min [2.00, 4.00]"),
        ("m", "3.00 m [2.00, 4.00]"),
        ("s", "3.00 s [2.00, 4.00]"),
        ("ratio", "3.00 times [2.00, 4.00]"),
        ("correlation", "3.00 [2.00, 4.00]"),
        ("fraction", "300.0 points [200.0, 400.0]"),
        ("share", "300.0 [200.0, 400.0]"),
    ],
)
def test_an_effect_has_its_unit(unit, text):
    assert with_interval(Estimate(3.0, 2.0, 4.0), unit) == text
    assert without_interval(1.5, "1/min") == "+1.50 1/min"


def test_a_limit_out_of_range_names_the_unit(leaks_unit):
    kind = f"number in {leaks_unit}, 0 or more" if leaks_unit else "number, 0 or more"
    with pytest.raises(SettingsError, match=f"--max-leaks is a {kind}, got -1"):
        Question(limits={"leaks": -1.0})


def test_the_options_of_design_name_unit_and_descriptor(leaks_unit, capsys):
    with pytest.raises(SystemExit):
        design.main(["--help"])
    said = " ".join(capsys.readouterr().out.split())
    about = f"leaks a minute, in {leaks_unit}" if leaks_unit else "leaks a minute"
    assert f"--max-leaks X {about} --" in said
    assert "--max-ael S AEL, in s --" in said
    assert "limit PLR, AEL, MEL and leaks a minute of the sent positions" in said


@pytest.mark.usefixtures("leaks_unit")
def test_a_limit_that_fails_is_a_sentence_with_the_unit():
    unit = metrics.METRICS["leaks"].unit
    attack = parse_consumer("radial_rts", "informed")
    check = Check("leaks", 50.0, Estimate(90.0, 80.0, 93.07), attack)
    text = reason(check, SimpleNamespace(), epsilon_m=0.3)
    amount, limit = f"93.07 {unit}".strip(), f"50 {unit}".strip()
    assert text.startswith(
        f"leaks a minute against an attack: up to {amount} (limit {limit})"
    )
    exposure = Check("ael", 0.5, Estimate(0.9, 0.8, 1.0), attack)
    assert reason(exposure, SimpleNamespace(), epsilon_m=0.3).startswith(
        "an attack leaves an average exposure length of up to 1.00 s (limit 0.5 s)"
    )


@pytest.mark.parametrize(
    ("unit", "effects"),
    [
        ("1/min", ("2 1/min", "-3 1/min")),
        ("s", ("2 s", "-3 s")),
        ("ratio", ("2", "-3")),
    ],
)
def test_a_changed_sign_has_the_unit_of_the_effect(unit, effects):
    row = {
        "variant": "law=x",
        "id": "claim/a",
        "changed": "changed sign",
        "decision_base": "holds",
        "effect_base": 2.0,
        "decision": "reversed",
        "effect": -3.0,
        "ci_low": -4.0,
        "ci_high": -2.0,
        "unit": unit,
    }
    before, after = effects
    assert sign_changes(pd.DataFrame([row])) == [
        f"law=x: claim/a: holds ({before}) -> reversed ({after} [-4, -2])"
    ]
