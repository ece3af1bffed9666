"""Paths and words fit to be passed on: without the folders of the user's machine."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from isac_track.datasets import Dataset


def public_path(path: str | Path) -> str:
    """Return a path fit to be passed on: below the working folder, else its name."""
    with contextlib.suppress(ValueError, OSError):
        below = Path(path).absolute().resolve().relative_to(Path.cwd().resolve())
        return str(below)
    return Path(path).name


def without_folders(text: str, dataset: Dataset) -> str:
    """Return a text about a recording with all its folders as `public_path` has them.

    So are the folders in which data sets are searched.
    """
    from isac_track.datasets.registry import (  # noqa: PLC0415 - of a run alone
        searched_folders,
        shown,
    )

    paths = [dataset.path, *map(shown, dataset.sessions), *searched_folders()]
    for path in sorted(paths, key=len, reverse=True):  # files before their folders
        if os.sep in path and Path(path).name:
            text = text.replace(path, public_path(path))
    return text


def public_words(words: Iterable[str]) -> list[str]:
    """Return the words of a command without the user's folders."""
    first, *others = [*words] or [""]
    return [Path(first).name, *map(_shown_word, others)]


def _shown_word(word: str) -> str:
    option, equals, value = word.partition("=")
    if not equals or not option.startswith("-"):
        option, equals, value = "", "", word
    is_elsewhere = value.startswith(("/", "~", "\\")) or value[1:3] == ":\\"
    if is_elsewhere or ".." in Path(value).parts:
        value = public_path(value.replace("\\", "/"))
    return f"{option}{equals}{value}"
