"""A real server on the loopback, where data sets are downloaded from."""

import contextlib
import http.server
import threading


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


@contextlib.contextmanager
def serving():
    """A server; fill its `files`, by path; `address` is to be told, `over` is set when it ends."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.files, server.asked, server.over = {}, [], threading.Event()
    server.address = f"http://127.0.0.1:{server.server_port}/base/"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server
    server.over.set()
    server.shutdown()
    thread.join()
    server.server_close()


def closed(handler):
    handler.connection.close()


def silent(handler):
    handler.server.over.wait(10)


def endless(handler):
    with contextlib.suppress(OSError):
        for _ in range(100_000):
            handler.wfile.write(bytes(100_000))


def trickling(handler):
    with contextlib.suppress(OSError):
        while not handler.server.over.wait(0.2):
            handler.wfile.write(b"x")
            handler.wfile.flush()
