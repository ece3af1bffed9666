import http.server
import os
import threading
from pathlib import Path

import pytest


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


class _Handler(http.server.BaseHTTPRequestHandler):
    """Answers with what `server.files` holds.

    Bytes, a status, a function of the handler, or (announced length, bytes, what comes then).
    """

    def do_GET(self):
        self.server.asked.append(self.path)
        answer = self.server.files.get(self.path, 404)
        if callable(answer):
            answer(self)
        elif isinstance(answer, int):
            self.send_error(answer)
        else:
            length, data, then = (
                answer if isinstance(answer, tuple) else (len(answer), answer, None)
            )
            self.send_response(200)
            if length is not None:
                self.send_header("Content-Length", str(length))
            self.end_headers()
            self.wfile.write(data)
            if then:
                then(self)

    def log_message(self, *_):
        pass


@pytest.fixture
def mirror(empty_machine, monkeypatch):  # noqa: ARG001 - the cache is to be empty
    """A real server on the loopback; fill its `files`, by path."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.files, server.asked = {}, []
    monkeypatch.setenv("ISAC_TRACK_MIRROR", f"http://127.0.0.1:{server.server_port}/base/")
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()
