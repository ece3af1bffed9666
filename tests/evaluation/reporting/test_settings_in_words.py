"""No text spells out a setting: the texts of a run with all settings changed."""

import re
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from typing import get_args

import pytest
from helpers.small_runs import smoke

from evaluation import design
from evaluation.api import run
from evaluation.reporting import page
from evaluation.reporting.figures.figure import make_figures
from evaluation.reporting.first_screen import first_screen
from isac_track.config import StageSettings

DEFAULTS = StageSettings().flat()
UNITS = {
    "mps": "m/s", "m2": "m²", "m": "m", "s": "s", "hz": "Hz", "ghz": "GHz",
    "mhz": "MHz", "db": "dB", "dbm": "dBm",
}  # fmt: skip
COUNTED = {
    "scenes.agents": "agents|people in a scene|pedestrians",
    "conflict.window": "samples",
    "conflict.horizon_steps": "steps",
    "attacks.repeats": "repeats|(further )?releases",
    "linkage.handover_instants": "instants",
    "linkage.most_people": "people",
}
"""Nouns after the number of a setting without a unit."""
# Settings that cannot be a quarter larger, or would need more people.
OWN = {
    "linkage.candidates": 0,
    "linkage.handover_instants": 9000,
    "scenes.history_ratio": 0.8,
    "linkage.most_people": 40,
    "linkage.trait_strength": 1.0,  # of the simulated crowd alone
    "conflict.horizons_s": "2.5",
}
DERIVED = {"0.93 s": "the horizon", "50 % of it": "of two releases the same steps"}


def other(key):
    """A value of a setting that is not the default."""
    stage, name = key.split(".")
    choices = get_args(type(getattr(StageSettings(), stage)).__annotations__[name])
    usual = DEFAULTS[key]
    if key in OWN:
        return OWN[key]
    if choices:
        return next(choice for choice in choices if choice != usual)
    if isinstance(usual, int):
        return usual + usual // 4 + 1
    return float(f"{1.25 * usual:.4g}") if isinstance(usual, float) else usual


# The settings of a run without patrols and tracks.
READ = [key for key in DEFAULTS if not key.startswith(("patrol.", "tracking."))]
CHANGED = {key: value for key in READ if (value := other(key)) != DEFAULTS[key]}


@pytest.fixture(scope="module")
def texts(tmp_path_factory):
    """All texts about a run with all settings changed, by their place."""
    folder = tmp_path_factory.mktemp("words")
    settings = smoke(
        "plaza",
        folder / "run",
        scenes=24,
        mechanisms=("raw", "fid:3", "fixed:0.83"),
        predictors=("kalman_cv",),
        attacks=("radial_rts", "shape", "kinematic"),
        tasks=("rerelease", "split", "handover-2s"),
        stages=StageSettings().changed(CHANGED),
    )
    results = run(settings, progress=False)
    results = replace(results, manifest=results.manifest | {"wall_time_s": 77.0})
    texts = {
        "first screen": "\n".join(first_screen(results)),
        "page": page.render(results, figures=make_figures(results)),
        "tables": (results.out / "tables.txt").read_text("utf-8"),
        "verdict": (results.out / "verdict.json").read_text("utf-8"),
    }
    for name, options in (("design", ()), ("design as shared", ("--as-shared",))):
        asked = (
            "--max-missed",
            "0.9",
            "--max-plr",
            "0.5",
            "--adding",
            "linear",
            *options,
        )
        with redirect_stdout(StringIO()) as sink:
            design.main([*asked, str(results.out)])
        texts[name] = sink.getvalue()
    # No setting gives the length of a scale bar, the gap in a task's name, or the
    # horizon of a question to the run (and the option that adds it).
    texts["page"] = re.sub(r'<svg class="track".*?</svg>', "", texts["page"])
    not_settings = (
        r"(?i)(after|across|of)\s[125]\ss\b|within\s3\ss\b"
        r"|--set\s+conflict\.horizons_s=3\b"
    )
    return {name: re.sub(not_settings, "", text) for name, text in texts.items()}


@pytest.mark.parametrize("key", [*CHANGED])
def test_no_text_has_the_default_of_a_setting_that_is_another(texts, key):
    usual, unit = DEFAULTS[key], UNITS.get(key.rpartition("_")[2], COUNTED.get(key))
    for where, text in texts.items():
        assert not re.search(re.escape(f"{key}={usual}") + r"(?![\d.])", text), where
        if unit is not None:
            number = re.escape(f"{float(usual):g}")
            phrase = rf"(?<![\d.^]){number}[ \u00a0]({unit})(?![\w/])"
            assert not re.search(phrase, text), (
                where,
                re.search(f".{{0,60}}{phrase}.{{0,20}}", text),
            )


@pytest.mark.parametrize("key", [*CHANGED])
def test_the_page_and_the_tables_name_every_setting_that_is_another(texts, key):
    for where in ("page", "tables"):
        assert f"{key}={CHANGED[key]}" in texts[where]


@pytest.mark.parametrize("phrase", DERIVED)
def test_what_follows_from_settings_is_not_spelled_out_either(texts, phrase):
    assert not any(phrase in text for text in texts.values())


def test_epsilon_is_that_of_the_run_wherever_it_is_named(texts):
    epsilon = f"{CHANGED['privacy.epsilon_m']:g} m"
    assert f"known to {epsilon}, %" in texts["first screen"]
    assert f"known to {epsilon} as sent" in texts["first screen"].replace("\n  ", " ")
    assert f"Positions known to {epsilon}" in texts["page"]
    assert f"to {epsilon}" in texts["design"].replace("\n", " ")


def test_the_speeds_of_used_and_recorded_tracks_are_compared(texts):
    least = f"tracks of at least {CHANGED['resample.min_duration_s']:g} s are"
    assert least in texts["tables"]
    assert least in texts["page"]


def test_every_setting_but_a_few_is_another():
    same = {*READ} - CHANGED.keys()
    assert same <= OWN.keys()
