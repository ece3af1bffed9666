"""What a reader sees: pages as programs see them, and texts that somebody has read."""

import os
from html.parser import HTMLParser


class Tags(HTMLParser):
    """Every tag of a page with its attributes, and the text that stands in it."""

    def __init__(self, text):
        super().__init__()
        self.opened = []
        self.text = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.opened.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)

    def attributes(self, name):
        return [values for tag, values in self.opened if tag == name]


def assert_as_approved(text, path):
    """A text equals a file; with APPROVE=1 the file is written anew, to be read."""
    if os.environ.get("APPROVE"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")


def tells_rows_apart(table):
    """Whether what is repeated where a table is split says which row is meant."""
    shown = [place for place, column in enumerate(table.columns) if not column.is_long]
    keys = {
        tuple(row[place].full for place in shown[: table.n_keys]) for row in table.rows
    }
    return len(keys) == len(table.rows)
