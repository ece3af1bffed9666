import os
from pathlib import Path

import pytest
from helpers.mirror import serving


@pytest.fixture
def empty_machine(monkeypatch, tmp_path):
    """An empty cache, without data folder and with a mirror that does not answer."""
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


def find_folder(name):
    """Give the user's data folder if it holds this recording, else skip the test."""
    folder = Path(os.environ.get("ISAC_TRACK_DATA", "nowhere"))
    if not (folder / name).is_dir():
        pytest.skip(f"needs {name}: set ISAC_TRACK_DATA")
    return folder


@pytest.fixture
def ucy():
    return find_folder("students03")


@pytest.fixture
def gc():
    return find_folder("gc")


@pytest.fixture
def single_file():
    return find_folder("singlefile") / "singlefile"


@pytest.fixture
def returners():
    return find_folder("returners") / "returners"


@pytest.fixture
def hermes():
    return find_folder("hermes") / "hermes"


@pytest.fixture
def mirror(empty_machine, monkeypatch):  # noqa: ARG001 - the cache is to be empty
    """A real server on the loopback; fill its `files`, by path."""
    with serving() as server:
        monkeypatch.setenv("ISAC_TRACK_MIRROR", server.address)
        yield server
