"""Files of a run folder: whole files with their rights, regular files."""

import os
import stat

import pytest

from evaluation.store.files import open_regular, write_whole


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
