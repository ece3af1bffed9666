"""The gallery of tracks: its people, their leaks, and its file in the run folder."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from evaluation.compute import sample_tracks
from evaluation.plan.plan import make_plan
from evaluation.plan.settings import Settings
from evaluation.store.files import SAMPLE_TRACKS
from evaluation.store.sample_tracks import read_sample_tracks, save_sample_tracks
from isac_track import plugins
from isac_track.errors import DataError


def gallery_table(plan, *specs):
    mechanisms = plugins.parse_all("mechanisms", specs)
    options = {
        "tracks": plan.scene_tracks,
        "attacks": (),
        "stages": plan.settings.stages,
        "seed": 0,
    }
    rows = [
        sample_tracks.sample_rows(mechanism, **options)
        for mechanism in sample_tracks.sample_mechanisms(mechanisms)
    ]
    return pa.concat_tables(rows)


@pytest.fixture(scope="module")
def gallery(plan):
    return gallery_table(
        plan, "raw", "fid:1", "fid:100", "fixed:0.2", "fixed:0.8"
    ).to_pandas()


@pytest.fixture(scope="module")
def plan():
    return make_plan(
        Settings(preset="smoke", dataset="plaza", scenes=2, attacks=(), tasks=())
    )


class TestTheGallery:
    def test_four_people_under_three_mechanisms(self, gallery):
        assert list(gallery.columns) == sample_tracks.COLUMNS
        assert list(gallery["mechanism"].unique()) == ["raw", "fid:1", "fixed:0.8"]
        assert gallery["track"].nunique() == 4
        assert set(gallery["attack"]) == {"radial_rts"}

    def test_a_leak_is_a_place_within_epsilon_of_the_truth(self, gallery):
        for item in ("shared", "rec"):
            x_m, y_m = (
                gallery[f"{axis}_{item}"] - gallery[f"{axis}_true"] for axis in "xy"
            )
            distance = np.hypot(x_m, y_m)
            sure = abs(distance - 0.3) > 0.002  # positions are kept in millimetres
            np.testing.assert_array_equal(
                (distance < 0.3)[sure], gallery[f"leaked_{item}"][sure]
            )

    def test_the_truth_is_the_same_whatever_is_shared(self, gallery):
        raw, fid = (gallery[gallery["mechanism"] == name] for name in ("raw", "fid:1"))
        np.testing.assert_array_equal(raw[["t", "x_true"]], fid[["t", "x_true"]])
        assert fid["leaked_shared"].mean() < raw["leaked_shared"].mean()

    def test_without_any_error_everything_leaks_and_what_is_not_shared_is_not_shown(
        self, plan
    ):
        whole, thin = (
            gallery_table(plan, spec).to_pandas() for spec in ("clean", "thin:4")
        )
        assert whole["leaked_shared"].all()
        np.testing.assert_array_equal(whole["x_shared"], whole["x_true"])
        assert 0.2 < len(thin) / len(whole) < 0.3
        assert (thin.groupby("track")["t"].diff().dropna() > 0).all()
        # What is shared lies about the truth of its own instant, not of another one.
        assert np.hypot(thin["x_shared"] - thin["x_true"], 0).median() < 1.0

    def test_it_is_kept_and_read_again(self, gallery, tmp_path):
        save_sample_tracks([pa.Table.from_pandas(gallery)], out=tmp_path)
        pd.testing.assert_frame_equal(read_sample_tracks(tmp_path), gallery)
        assert read_sample_tracks(tmp_path / "other") is None

    @pytest.mark.parametrize("content", [b"no parquet", None])
    def test_a_broken_one_is_an_error_that_says_what_to_do(self, tmp_path, content):
        path = tmp_path / SAMPLE_TRACKS
        if content is None:
            pd.DataFrame({"other": [1]}).to_parquet(path)
        else:
            path.write_bytes(content)
        with pytest.raises(DataError, match="delete it"):
            read_sample_tracks(tmp_path)
