"""Fetch the files of a known data set into the cache: pinned commit, checked sha256."""

from __future__ import annotations

import contextlib
import hashlib
import os
from typing import TYPE_CHECKING

from isac_track.datasets.registry import (
    DATA_VARIABLE,
    cache_folder,
    locate,
    missing,
    read_bytes,
    shown,
)
from isac_track.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    from isac_track.datasets.registry import Known

MIRROR_VARIABLE = "ISAC_TRACK_MIRROR"
"""Base URL to download from instead of GitHub; hashes are checked all the same."""
_OPENTRAJ = (
    "https://raw.githubusercontent.com/crowdbotp/OpenTraj/"
    "97ec1d5e1b579f26febeaa9083705952deac338a/datasets/UCY"
)
CONNECT_TIMEOUT_S = 5.0
READ_TIMEOUT_S = 30.0
_CHUNK_BYTES = 16_384
_MOST_BYTES = 100_000_000
"""Far more than any known file: what goes on for longer is not one of them."""


def url_of(data_set: Known, file_name: str) -> str:
    """Return where a file of a known data set is downloaded from."""
    base = os.environ.get(MIRROR_VARIABLE, "").strip() or _OPENTRAJ
    return f"{base.rstrip('/')}/{data_set.name}/{file_name}"


def fetch(data_set: Known) -> tuple[dict[str, Path], bool]:
    """Return the path of every file, and whether any was downloaded.

    Files go to the cache whole and checked, or not at all. A damaged file in the cache is ours to
    replace; one in the user's own folder is not. Progress is shown on stderr. It is a DataError
    if a file cannot be had, with the way out, or if the user's own is not the right one.
    """
    import requests  # noqa: PLC0415 - a plain import of the package stays quick

    folder = cache_folder() / data_set.name
    files = {}
    for file_name, path in locate(data_set).items():
        try:
            read_bytes(path, data_set=data_set)
        except DataError:
            if path != folder / file_name:
                raise
        else:
            files[file_name] = path
    absent = missing(data_set, files)
    for file_name in absent:
        url, target = url_of(data_set, file_name), folder / file_name
        way_out = (
            f"Way out: get {' and '.join(data_set.sha256)} of that folder by any means, save in "
            f"DIR/{data_set.name} and set {DATA_VARIABLE}=DIR"
        )
        unchecked = folder / f".{file_name}.{os.getpid()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            actual = _download(url, unchecked, title=f"{data_set.name}/{file_name}")
            if actual != data_set.sha256[file_name]:
                raise ValueError(f"sha256 is {actual}, expected {data_set.sha256[file_name]}")  # noqa: TRY301 - told below
            unchecked.replace(target)
        except requests.RequestException as error:
            raise DataError(f"{url}: {_reason(error)}. {way_out}") from None
        except OSError as error:
            reason = error.strerror or type(error).__name__
            raise DataError(f"{shown(target)}: cannot be written ({reason})") from None
        except ValueError as error:
            raise DataError(f"{url}: not the expected file: {error}. {way_out}") from None
        finally:
            with contextlib.suppress(OSError):
                unchecked.unlink()
        files[file_name] = target
    return files, bool(absent)


def _reason(error: Exception) -> str:
    """Return in words why requests got nothing."""
    from requests import exceptions  # noqa: PLC0415 - as above

    if isinstance(error, exceptions.HTTPError):
        return f"the server answered {getattr(error.response, 'status_code', '')}"
    # A server that falls silent in the middle is no Timeout to requests.
    silent = "no answer in time"
    broken = silent if "timed out" in str(error) else "no connection, or it broke off (offline?)"
    for kind, reason in (
        (exceptions.ProxyError, "the proxy refuses the connection"),
        (exceptions.SSLError, "no trusted connection (a proxy that opens TLS?)"),
        (exceptions.ChunkedEncodingError, "the connection broke off"),
        (exceptions.Timeout, silent),
        (exceptions.ConnectionError, broken),
    ):
        if isinstance(error, kind):
            return reason
    return f"cannot be downloaded ({type(error).__name__})"


def _download(url: str, into: Path, *, title: str) -> str:
    """Write what `url` gives to a file, with a progress bar; return its sha256."""
    import requests  # noqa: PLC0415 - as above
    from rich import progress  # noqa: PLC0415
    from rich.console import Console  # noqa: PLC0415

    bar = progress.Progress(
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(bar_width=30),
        progress.DownloadColumn(),
        console=Console(stderr=True),
    )
    with requests.get(
        url,
        stream=True,
        timeout=(CONNECT_TIMEOUT_S, READ_TIMEOUT_S),
        # Unpacked on the way, a body could not be measured against its announced length.
        headers={"Accept-Encoding": "identity"},
    ) as response:
        response.raise_for_status()
        announced = response.headers.get("Content-Length", "")
        with bar, into.open("wb") as file:
            task = bar.add_task(title, total=int(announced) if announced.isdigit() else None)
            digest = hashlib.sha256()
            for chunk in response.iter_content(_CHUNK_BYTES):
                file.write(chunk)
                digest.update(chunk)
                if file.tell() > _MOST_BYTES:
                    raise ValueError(f"over {_MOST_BYTES} bytes")
                bar.advance(task, len(chunk))
    return digest.hexdigest()
