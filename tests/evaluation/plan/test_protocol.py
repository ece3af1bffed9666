"""The protocol is frozen: whoever changes a value must give it a new version."""

import re
import tomllib
from dataclasses import replace
from importlib.resources import files

import pytest

from evaluation.plan.protocol import protocol_digest, read_protocol
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.datasets.registry import KNOWN
from isac_track.errors import SettingsError
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.plugins import parse

FROZEN = {1: "a978d3e0787333d1fa4504e330dd11e3158874a66934bc828c05966f87c6fd35"}
"""The digest of each version that was published; none is ever changed."""
READ_ON_PATROL = ("sensing", "conflict", "privacy", "patrol")


def content():
    text = files("evaluation").joinpath("protocol.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def test_a_published_version_never_changes():
    protocol = read_protocol()
    assert FROZEN[protocol.version] == protocol.digest


def test_the_digest_is_of_the_values_not_of_their_layout():
    values = content()
    turned = dict(reversed(list(values.items())))
    assert protocol_digest(turned) == protocol_digest(values)
    changed = values | {"horizon_s": 3.5}
    assert protocol_digest(changed) != protocol_digest(values)


def test_all_settings_that_a_patrol_reads_are_in_the_protocol():
    named = {*read_protocol().settings, "sensing.law", "conflict.horizons_s"}
    read = {
        name
        for name in StageSettings().flat()
        if name.partition(".")[0] in READ_ON_PATROL
    }
    assert read - named == {"privacy.intervals"}  # of AEL and MEL, which cards lack


def test_all_plugins_and_estimators_exist():
    protocol = read_protocol()
    for kind, specs in {
        "mechanisms": protocol.mechanisms,
        "policies": protocol.policies,
        "predictors": protocol.robots,
        "attacks": protocol.attacks,
    }.items():
        for spec in specs:
            assert len(parse(kind, spec)) == 1
    assert protocol.log == ESTIMATORS


def test_recordings_are_those_of_the_registry():
    digests = {
        digest for known in KNOWN.values() for digest in known.sha256.values() if digest
    }
    recordings = dict(read_protocol().recordings)
    assert recordings.pop("plaza") == datasets.load("plaza").sha256
    assert set(recordings.values()) <= digests
    assert recordings.keys() <= KNOWN.keys()


def test_the_defaults_of_the_project_do_not_reach_a_card():
    protocol = read_protocol()
    other = replace(protocol, settings={**protocol.settings, "patrol.scan_s": 0.1})
    assert protocol.stages("radial").patrol.scan_s == 0.0836
    assert other.stages("isotropic").patrol.scan_s == 0.1
    assert protocol.stages("isotropic").sensing.law == "isotropic"


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda p: p.stages("radal"), "--law 'radal' .* did you mean radial"),
        (lambda p: p.recording_digest("students3"), "did you mean students03"),
    ],
)
def test_a_wrong_name_is_answered_in_a_line(ask, message):
    with pytest.raises(SettingsError, match=message) as error:
        ask(read_protocol())
    assert not re.search(r"\n", str(error.value))
