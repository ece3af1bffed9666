"""What is refused before anything is computed."""

import pytest

from evaluation.plan.plan import plan
from evaluation.plan.settings import Settings
from isac_track.config import StageSettings
from isac_track.errors import SettingsError


def test_settings_of_patrols_are_refused_since_a_run_would_ignore_them():
    settings = Settings(stages=StageSettings().changed({"patrol.robots": "3"}))
    with pytest.raises(
        SettingsError, match=r"patrol\.\* settings change nothing in a run"
    ):
        plan(settings)
