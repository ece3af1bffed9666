"""Files of a run folder: the lock, whole files with their rights, regular files."""

import os
import stat

import pytest

from evaluation.store.files import locked, open_regular, write_whole
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


@pytest.mark.parametrize("mode", [0o600, 0o644])
def test_a_whole_file_replaces_a_link_and_has_its_rights(mode, tmp_path):
    (tmp_path / "precious").write_text("precious")
    (path := tmp_path / "file").symlink_to("precious")
    write_whole(path, b"content", mode=mode)
    assert path.read_bytes() == b"content"
    assert not path.is_symlink()
    assert stat.S_IMODE(path.stat().st_mode) == mode
    assert (tmp_path / "precious").read_text() == "precious"
    assert {item.name for item in tmp_path.iterdir()} == {"precious", "file"}


@pytest.mark.parametrize("mode", ["rb", "ab+"])
@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_what_is_no_regular_file_is_not_opened(kind, mode, tmp_path):
    (tmp_path / "precious").write_text("precious")
    path = tmp_path / "planted"
    make = {"link": lambda place: place.symlink_to("precious"), "pipe": os.mkfifo}
    make.get(kind, os.mkdir)(path)
    with pytest.raises(OSError, match="planted"):
        open_regular(path, mode)
