"""The lock of a run folder."""

import os

import pytest

from evaluation.store.lock import locked
from isac_track.errors import SettingsError


class TestLock:
    def test_removes_half_written_files_and_at_its_end_its_own_file(self, tmp_path):
        left = tmp_path / f".summary.csv.{16 * '0'}.tmp"
        left.write_text("half")
        with locked(tmp_path):
            assert not left.exists()
            assert (tmp_path / ".lock").exists()
            left.write_text("half, of this run")
        assert not (tmp_path / ".lock").exists()
        assert left.exists()

    def test_names_the_process_that_holds_it(self, tmp_path):
        with (
            locked(tmp_path),
            pytest.raises(SettingsError, match=rf"\(process {os.getpid()}\)"),
            locked(tmp_path),
        ):
            raise AssertionError("two hold it")
        with locked(tmp_path):
            pass

    def test_is_held_where_its_file_has_long_content(self, tmp_path):
        (tmp_path / ".lock").write_text("12345678901\n" * 9)
        with locked(tmp_path):
            assert (tmp_path / ".lock").read_text() == f"{os.getpid()}\n"

    def test_ends_with_an_error_within(self, tmp_path):
        with pytest.raises(ZeroDivisionError), locked(tmp_path):
            raise ZeroDivisionError
        with locked(tmp_path):
            pass
