"""Plain names: everything that is built in has one, and a user's own keeps its SPEC."""

import pytest

from attacks.tasks.task_list import ALL_TASKS
from evaluation.estimates.families import Family
from evaluation.estimates.strongest import BEYOND
from evaluation.reporting import names
from evaluation.reporting.names import (
    mechanism_name,
    mechanism_phrase,
    short_mechanism_name,
)
from isac_track import plugins

INDEPENDENT = "fid:adding=independent"
WHITE = "fixed:adding=independent,law=isotropic"


@pytest.mark.parametrize(
    ("mechanism", "level", "name", "short", "phrase"),
    [
        ("raw", None, "raw positions", "raw positions", "raw positions"),
        (
            "fid",
            1e6,
            "FID noise, eta 1000000",
            "FID noise, eta 1000000",
            "FID noise at eta 1000000",
        ),
        (
            INDEPENDENT,
            1.0,
            "FID noise, eta 1 (independent)",
            "FID noise, eta 1 *",
            "FID noise at eta 1 (independent)",
        ),
        (
            WHITE,
            0.5,
            "isotropic fixed noise, 0.5 m (independent)",
            "isotropic fixed noise, 0.5 m *",
            "isotropic fixed noise of 0.5 m (independent)",
        ),
        (
            "ou:tau_s=2",
            0.4,
            "slow noise, 0.4 m (tau_s=2)",
            "slow noise, 0.4 m (tau_s=2)",
            "slow noise of 0.4 m (tau_s=2)",
        ),
        ("thin", 2.0, *["one sample in 2"] * 3),
        ("a.b:Mine", 3.0, "Mine:3", "Mine:3", "Mine:3"),
    ],
)
def test_a_level_has_a_name_for_a_table_and_for_a_sentence(
    mechanism, level, name, short, phrase
):
    name_of_plugin = mechanism if "." in mechanism else mechanism.partition(":")[0]
    family = Family(mechanism, name_of_plugin, "")
    assert mechanism_name(family, level) == name
    assert short_mechanism_name(family, level) == short
    assert mechanism_phrase(family, level) == phrase


def test_every_mechanism_and_predictor_of_the_project_has_a_plain_name():
    for mechanism in plugins.names("mechanisms"):
        assert mechanism_name(Family(mechanism, mechanism, ""), 3.0) != f"{mechanism}:3"
    for predictor in plugins.names("predictors"):
        assert names.is_built_in_robot(predictor)
        assert names.robot_subject(predictor).startswith(("a ", "the "))


def test_every_task_and_adversary_of_the_project_has_a_plain_name():
    for task in ALL_TASKS:
        assert names.task_phrase(task) != f"in {task}"
        assert len(names.task_head(task)) <= 11
    for adversary in BEYOND:
        assert names.adversary_name(adversary).startswith("an adversary with ")


def test_what_is_not_known_keeps_its_own_name():
    assert names.robot_subject("mine:gain=2") == "a robot with mine:gain=2"
    assert not names.is_built_in_robot("mine:gain=2")
    assert names.task_phrase("my_task") == "in my_task"
    assert names.dataset_title("students03") == "Students03"
    assert names.dataset_title("my walks.csv") == "my walks.csv"
