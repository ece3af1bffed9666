"""A real server on the loopback, where data sets are downloaded from."""

import contextlib
import hashlib
import http.server
import threading

WALK = b"1 1 0 0 0 0 0 0\n11 1 0.4 0 0 0 0 0\n"
OTHER = WALK + b"\n"


class _Handler(http.server.BaseHTTPRequestHandler):
    """Answers with what `server.files` holds.

    Bytes, a status, a function of the handler, or (announced length, bytes, what comes
    then).
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
    """A server of `files` by path; `address` is its own, `over` is set when it ends."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.files, server.asked, server.over = {}, [], threading.Event()
    server.address = f"http://127.0.0.1:{server.server_port}/base/"
    thread = threading.Thread(
        target=server.serve_forever, kwargs={"poll_interval": 0.02}
    )
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


def answers(header, *, then=None):
    """Answer with a whole header, as it is, and what comes after it."""

    def answer(handler):
        handler.wfile.write(header)
        if then:
            then(handler)

    return answer


def redirected(to):
    return answers(
        f"HTTP/1.0 302 Found\r\nLocation: {to}\r\nContent-Length: 0\r\n\r\n".encode()
    )


def slow_header(handler):
    while not handler.server.over.wait(0.2):
        handler.wfile.write(b"X-Patience: a virtue\r\n")


FAILS = {
    # What the server does: and what is said of it.
    "not there": (404, "the server answered 404"),
    "forbidden": (403, "the server answered 403"),
    "overloaded": (503, "the server answered 503"),
    "another file": (
        OTHER,
        (
            f"not the expected file: sha256 is {hashlib.sha256(OTHER).hexdigest()},"
            " expected"
        ),
    ),
    "nothing": (b"", "not the expected file: sha256 is e3b0c442"),
    "cut short": ((len(WALK), WALK[:10], None), "the connection broke off"),
    "longer than announced": ((10, WALK, None), "not the expected file: sha256 is"),
    "hangs up": (closed, "no connection, or it broke off"),
    "says nothing": (silent, "no answer in time"),
    "falls silent": ((len(WALK), WALK[:10], silent), "no answer in time"),
    "trickles": ((len(WALK), WALK[:10], trickling), "no answer in time"),
    "a slow header": (
        answers(b"HTTP/1.0 200 OK\r\n", then=slow_header),
        "no answer in time",
    ),
    "without end": (
        (None, b"", endless),
        "not the expected file: over 100000000 bytes",
    ),
    "of a terabyte": (
        (10**12, b"", endless),
        "not the expected file: over 100000000 bytes",
    ),
    "no HTTP": (answers(b"SSH-2.0-what\r\n"), "no connection, or it broke off"),
    "turns in a circle": (
        redirected("obsmat.txt"),
        "cannot be downloaded (TooManyRedirects)",
    ),
    "points into the machine": (
        redirected("file:///obsmat.txt"),
        "cannot be downloaded",
    ),
    "points to nobody": (
        redirected("http://127.0.0.1:1/"),
        "no connection, or it broke off",
    ),
}
