import os
from pathlib import Path

import pytest
from helpers.mirror import serving


@pytest.fixture
def empty_machine(monkeypatch, tmp_path):
    """No data folder, an empty cache, and a mirror where nobody listens; gives the cache."""
    monkeypatch.delenv("ISAC_TRACK_DATA", raising=False)
    monkeypatch.setenv("ISAC_TRACK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("ISAC_TRACK_MIRROR", "http://127.0.0.1:1")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    return tmp_path / "cache"


@pytest.fixture
def data_folder(empty_machine, monkeypatch, tmp_path):  # noqa: ARG001 - all else is to be empty
    """An empty data folder of the user's."""
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("ISAC_TRACK_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def ucy():
    """Give the folder of the real recordings, which are not part of the project."""
    folder = Path(os.environ.get("ISAC_TRACK_DATA", "nowhere"))
    if not (folder / "students03" / "obsmat.txt").is_file():
        pytest.skip("needs the UCY recordings: set ISAC_TRACK_DATA")
    return folder


@pytest.fixture
def gc():
    """Skip where Grand Central is not at hand, which is not part of the project."""
    if not (Path(os.environ.get("ISAC_TRACK_DATA", "nowhere")) / "gc").is_dir():
        pytest.skip("needs Grand Central: set ISAC_TRACK_DATA")


@pytest.fixture
def mirror(empty_machine, monkeypatch):  # noqa: ARG001 - the cache is to be empty
    """A real server on the loopback; fill its `files`, by path."""
    with serving() as server:
        monkeypatch.setenv("ISAC_TRACK_MIRROR", server.address)
        yield server


@pytest.fixture
def single_file():
    """Give the folder of the single-file experiments, which are not part of the project."""
    folder = Path(os.environ.get("ISAC_TRACK_DATA", "nowhere")) / "singlefile"
    if not folder.is_dir():
        pytest.skip("needs the single-file experiments: set ISAC_TRACK_DATA")
    return folder
