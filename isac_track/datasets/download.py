"""Fetch the files of a known data set into the cache: pinned commit, checked sha256."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from isac_track.datasets.registry import DATA_VARIABLE, cache_folder, checked_bytes, shown
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping

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


def fetch(data_set: Known, *, found: Mapping[str, Path]) -> dict[str, Path]:
    """Return the path of every file, after downloading those that are not in `found`.

    Files go to the cache whole and checked, or not at all. Progress is shown on stderr.

    Raises
    ------
    DataError
        If a file cannot be had, with the way out.
    """
    files = dict(found)
    for file_name, sha256 in data_set.sha256.items():
        if file_name not in files:
            target = cache_folder() / data_set.name / file_name
            _download(data_set, file_name=file_name, target=target, sha256=sha256)
            files[file_name] = target
    return files


def usable(data_set: Known, *, found: Mapping[str, Path]) -> dict[str, Path]:
    """Return those of `found` that a download need not replace.

    A damaged file in the cache is ours to replace; one in the user's own folder is not.

    Raises
    ------
    DataError
        If a file in the user's data folder is not the right one.
    """
    files = {}
    for file_name, path in found.items():
        try:
            checked_bytes(path, data_set=data_set)
        except DataError:
            if path != cache_folder() / data_set.name / file_name:
                raise
        else:
            files[file_name] = path
    return files


def _download(data_set: Known, *, file_name: str, target: Path, sha256: str) -> None:
    import pooch  # noqa: PLC0415 - a plain import stays quick
    import requests  # noqa: PLC0415

    url = url_of(data_set, file_name)
    way_out = (
        f"Way out: get {' and '.join(data_set.sha256)} of that folder by any means, save in "
        f"DIR/{data_set.name} and set {DATA_VARIABLE}=DIR"
    )
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel("ERROR")  # pooch announces every download; the bar does that
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        pooch.retrieve(
            url,
            known_hash=f"sha256:{sha256}",
            fname=file_name,
            path=target.parent,
            downloader=lambda url, output_file, _: _stream(
                url, output_file, f"{data_set.name}/{file_name}"
            ),
        )
    except requests.HTTPError as error:
        status = "" if error.response is None else f" {error.response.status_code}"
        raise DataError(f"{url}: the server answered{status}. {way_out}") from None
    except requests.exceptions.ProxyError:
        raise DataError(f"{url}: the proxy refuses the connection. {way_out}") from None
    except requests.exceptions.SSLError:
        reason = "no trusted connection (a proxy that opens TLS?)"
        raise DataError(f"{url}: {reason}. {way_out}") from None
    except requests.exceptions.ChunkedEncodingError:
        raise DataError(f"{url}: the connection broke off. {way_out}") from None
    except requests.Timeout:
        raise DataError(f"{url}: no answer in time. {way_out}") from None
    except requests.ConnectionError as error:
        # A server that falls silent in the middle is no Timeout to requests.
        reason = "no connection, or it broke off (offline?)"
        reason = "no answer in time" if "timed out" in str(error) else reason
        raise DataError(f"{url}: {reason}. {way_out}") from None
    except requests.RequestException as error:
        raise DataError(
            f"{url}: cannot be downloaded ({type(error).__name__}). {way_out}"
        ) from None
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise DataError(f"{shown(target)}: cannot be written ({reason})") from None
    except ValueError as error:
        # pooch found a wrong hash; the text names the expected one, then the actual one.
        hashes = re.findall(r"\b[0-9a-f]{64}\b", str(error))
        reason = f"sha256 is {hashes[-1]}, expected {sha256}" if hashes else str(error)
        raise DataError(f"{url}: not the expected file: {reason}. {way_out}") from None
    finally:
        logger.setLevel(level)


def _stream(url: str, output_file: str, title: str) -> None:
    """Write what `url` gives to a file, with a progress bar on stderr."""
    import requests  # noqa: PLC0415 - a plain import of the package stays quick
    from rich import progress  # noqa: PLC0415
    from rich.console import Console  # noqa: PLC0415

    bar = progress.Progress(
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(bar_width=30),
        progress.DownloadColumn(),
        console=Console(stderr=True),
    )
    # pooch's own downloader would leave the connection open behind an error.
    with requests.get(
        url,
        stream=True,
        timeout=(CONNECT_TIMEOUT_S, READ_TIMEOUT_S),
        # Unpacked on the way, a body could not be measured against its announced length.
        headers={"Accept-Encoding": "identity"},
    ) as response:
        response.raise_for_status()
        announced = response.headers.get("Content-Length", "")
        with bar, Path(output_file).open("wb") as file:
            task = bar.add_task(title, total=int(announced) if announced.isdigit() else None)
            for chunk in response.iter_content(_CHUNK_BYTES):
                file.write(chunk)
                if file.tell() > _MOST_BYTES:
                    raise ValueError(f"over {_MOST_BYTES} bytes")
                bar.advance(task, len(chunk))
