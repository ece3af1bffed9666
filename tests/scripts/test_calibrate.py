"""The calibration recovers planted constants."""

import re
from dataclasses import asdict

import calibrate
import pytest
from calibration import descriptors, fit, links, predictions

from isac_track.config import PrivacySettings, SensingSettings, StageSettings
from isac_track.errors import DataError
from isac_track.scenes import cut

N_SCENES = 250


@pytest.fixture(scope="module")
def known(tracks):
    return cut(tracks, settings=StageSettings(), seed=0)


@pytest.fixture(scope="module")
def blocks(known):
    return links(known, stages=StageSettings(), n_scenes=N_SCENES, seed=0)


def make_targets(blocks, settings):
    raw_plr, raw_mel_s = descriptors(blocks, settings=settings, rule=PrivacySettings())
    fid_plr, _ = descriptors(
        blocks, settings=settings, rule=PrivacySettings(), eta=1000.0
    )
    return raw_plr, raw_mel_s, fid_plr


def test_planted_constants_are_recovered(blocks):
    planted = SensingSettings(
        processing_gain_db=29.0, large_scale_db=9.0, crb_gap_db=11.0
    )
    fitted = fit(blocks, stages=StageSettings(), targets=make_targets(blocks, planted))
    # 250 scenes make the MEL a staircase of about 0.05 dB.
    assert fitted.large_scale_db == pytest.approx(9.0, abs=0.1)
    assert fitted.crb_gap_db == pytest.approx(11.0, abs=0.1)
    assert fitted.processing_gain_db == pytest.approx(29.0, abs=0.15)


def test_the_short_way_gives_the_numbers_of_the_pipeline(known, blocks):
    settings = StageSettings().sensing
    ours = predictions(known, stages=StageSettings(), n_scenes=N_SCENES, seed=0)
    for spec, eta in (("raw", None), ("fid:1000", 1000.0)):
        plr, mel_s = descriptors(
            blocks, settings=settings, rule=PrivacySettings(), eta=eta
        )
        assert ours[spec, "plr"] == pytest.approx(plr, abs=1e-6)
        assert ours[spec, "mel"] == pytest.approx(mel_s, abs=1e-4)


def test_a_number_out_of_reach_is_an_error(blocks):
    with pytest.raises(DataError, match="gives the paper's raw PLR"):
        fit(blocks, stages=StageSettings(), targets=(1.5, 5.0, 0.2))


def test_the_command_shows_the_fit_and_its_predictions(csv_recording, capsys):
    assert calibrate.main(["--dataset", str(csv_recording), "--scenes", "40"]) == 0
    shown = capsys.readouterr().out
    for name in ("processing_gain_db", "large_scale_db", "crb_gap_db", "fixed:1 plr"):
        assert re.search(rf"{name}\W+[0-9.]+", shown)
    # Raw PLR is fitted: ours is the paper's.
    assert re.search(r"raw plr\W+52\.6\W+52\.\d", shown)


@pytest.mark.slow
def test_the_committed_constants_are_its_output(students03, capsys):
    assert students03.name == "students03"
    assert calibrate.main([]) == 0
    shown = capsys.readouterr().out
    defaults = asdict(SensingSettings())
    for name in ("processing_gain_db", "large_scale_db", "crb_gap_db"):
        match = re.search(rf"{name}\W+([0-9.]+)", shown)
        assert float(match[1]) == pytest.approx(defaults[name], abs=0.011)
