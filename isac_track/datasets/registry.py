"""Data sets that are known by name: their files on this machine, and downloads."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import time
import tomllib
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from isac_track.datasets.recording import printable
from isac_track.errors import DataError, did_you_mean

if TYPE_CHECKING:
    import requests

# Environment variables: the user's folder of data sets, ``NAME/obsmat.txt``, which is
# only read; the folder for downloads, instead of the user's cache; the base URL instead
# of GitHub's, with hashes checked all the same.
DATA_VARIABLE = "ISAC_TRACK_DATA"
CACHE_VARIABLE = "ISAC_TRACK_CACHE"
MIRROR_VARIABLE = "ISAC_TRACK_MIRROR"
DEFAULT = "students03"
FALLBACK = "plaza"
MAIN_FILE = "obsmat.txt"
GROUPS_FILE = "groups.txt"
WHOLE = ""  # Instead of a file name: the folder of a data set, hashed by its reader.
_OPENTRAJ = (
    "https://raw.githubusercontent.com/crowdbotp/OpenTraj/"
    "97ec1d5e1b579f26febeaa9083705952deac338a/datasets"
)
CONNECT_TIMEOUT_S = 5.0
READ_TIMEOUT_S = 30.0
# A download may take this long, plus the time of a slow line for its size.
LEAST_S = 60.0
LEAST_BYTES_PER_S = 50_000.0
_CHUNK_BYTES = 16_384
# Far more than any known file: a longer answer is another file.
_MOST_BYTES = 100_000_000


@dataclass(frozen=True, slots=True)
class Known:
    """A data set that is known by name, or a file of the user's own."""

    name: str
    about: str = ""
    citation: str = ""
    licence: str = ""
    # Number of the bundled session, if this is the bundled crowd.
    session: int | None = None
    format: str = ""
    fps: float | None = None
    unit: str = ""  # Unit of length, unless the file says so.
    sha256: Mapping[str, str] = field(default_factory=dict)
    """Hash of every file, by file name; empty for a bundled or the user's own file."""
    remote: str = ""  # Its folder in OpenTraj.
    # Pattern of the files that are sessions; known hashes are in `sha256`.
    sessions: str = ""
    # How to get a data set that is never downloaded from here: a folder of its name.
    get: str = ""
    folder: str = ""  # The folder of its files, if it is not called like the data set.
    withdrawn: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """By file and passage: why a label of the file is not believed."""

    @property
    def place(self) -> Path:
        """Its folder within the user's folder of data sets or the cache."""
        return Path(self.folder or self.name)


_TABLES = tomllib.loads(
    Path(__file__).with_name("known.toml").read_text(encoding="utf-8")
)
KNOWN: Mapping[str, Known] = {
    name: Known(name, **table) for name, table in _TABLES.items()
}


def known(name: str) -> Known:
    """Return the data set called `name`; DataError, with a hint, if there is none."""
    if name in KNOWN:
        return KNOWN[name]
    hint = did_you_mean(name.lower(), KNOWN)
    raise DataError(
        f"{name!r} is neither a known data set nor a file{hint} (known:"
        f" {', '.join(KNOWN)})"
    )


def _folder(variable: str) -> Path | None:
    """Return the folder that an environment variable names, if it is set."""
    value = os.environ.get(variable, "").strip()
    return Path(os.path.expanduser(value)) if value else None  # noqa: PTH111 - never raises


def cache_folder() -> Path:
    """Return the folder of downloads: ``ISAC_TRACK_CACHE`` or the user's cache."""
    if folder := _folder(CACHE_VARIABLE):
        return folder
    import pooch  # noqa: PLC0415 - a plain import stays quick

    return Path(pooch.os_cache("isac-track"))


def locate(data_set: Known) -> tuple[dict[str, Path], list[str]]:
    """Return the paths of a data set's files by name, and the names of missing files.

    The user's folder comes before the cache.
    """
    folders = [folder for folder in (cache_folder(), _folder(DATA_VARIABLE)) if folder]
    is_folder = WHOLE in data_set.sha256
    names = [WHOLE] if is_folder else [*data_set.sha256]
    is_here = os.path.isdir if is_folder else os.path.isfile  # These never raise.
    files = {
        file_name: folder / data_set.place / file_name
        for folder in folders
        for file_name in names
        if is_here(folder / data_set.place / file_name)
    }
    return files, [file_name for file_name in names if file_name not in files]


def describe_lookup() -> str:
    """Return in words the places where a data set was looked for."""
    folder = _folder(DATA_VARIABLE)
    first = f"{DATA_VARIABLE} is not set"
    if folder is not None:
        lacks = "" if os.path.isdir(folder) else ", which is no folder"  # noqa: PTH112 - never raises
        first = f"{DATA_VARIABLE} is {shown(folder)}{lacks}"
    return f"{first}; cache is {shown(cache_folder())}"


def searched_folders() -> list[str]:
    """Return the folders that `describe_lookup` names, as it shows them."""
    folders = (_folder(DATA_VARIABLE), cache_folder())
    return [shown(folder) for folder in folders if folder is not None]


def shown(path: Path | str) -> str:
    """Return a path as a printable line, whatever bytes its name has."""
    return printable(str(path).encode("utf-8", "replace").decode())


def read_bytes(path: Path, *, data_set: Known | None = None) -> bytes:
    """Return the bytes of a file; DataError if it is unreadable or the wrong file."""
    try:
        if not path.is_file():
            reason = "this is a folder, not a file" if path.is_dir() else "no such file"
            raise DataError(f"{shown(path)}: {reason}")
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{shown(path)}: cannot be read ({error.strerror})") from None
    if data_set and path.name in data_set.sha256:
        check(
            path, data_set, file_name=path.name, actual=hashlib.sha256(data).hexdigest()
        )
    return data


def check(path: Path, data_set: Known, *, file_name: str, actual: str) -> None:
    """Raise DataError if a file or folder of a known data set has a wrong hash."""
    if actual != (expected := data_set.sha256.get(file_name, actual)):
        raise DataError(
            f"{shown(path)} is not the {file_name or 'folder'} of {data_set.name}:"
            f" sha256 is {actual}, expected {expected}. Remove it and run `python -m"
            f" isac_track.datasets fetch {data_set.name}`, or use it as a recording of"
            " your own: give its path, --format"
            f" {data_set.format}{' and --fps' if data_set.fps else ''}"
        )


def file_url(data_set: Known, file_name: str) -> str:
    """Return the address from which a file of a known data set is downloaded."""
    if base := os.environ.get(MIRROR_VARIABLE, "").strip():
        return f"{base.rstrip('/')}/{data_set.name}/{file_name}"
    return f"{_OPENTRAJ}/{data_set.remote}/{file_name}"


def find_data_files(data_set: Known, *, download: bool) -> dict[str, Path]:
    """Return the path of every file of a known data set; download what is missing.

    DataError if a file is missing and `download` is False.
    """
    files, absent = locate(data_set)
    if absent and download:
        return fetch(data_set)[0]
    if absent:
        present = "".join(f"; {shown(path)} is" for path in files.values())
        missing = " and ".join(filter(None, absent)) or "its folder"
        raise DataError(
            f"{data_set.name}: {missing} not found{present} ({describe_lookup()}). "
            f"To get it: python -m isac_track.datasets fetch {data_set.name}"
        )
    return files


def fetch(data_set: Known) -> tuple[dict[str, Path], bool]:
    """Return the path of every file, and whether any was downloaded.

    Files go to the cache whole and checked, or not at all. A damaged file in the cache
    is replaced; a damaged file in the user's own folder is not. Downloads are announced
    on stderr. DataError, with the way out, if a file cannot be had, or if the user's
    own file is not the right file.
    """
    import requests  # noqa: PLC0415 - a plain import of the package stays quick
    import urllib3  # noqa: PLC0415 - as above

    folder = cache_folder() / data_set.name
    files, absent = locate(data_set)
    if data_set.get and absent:
        way_out = f"and set {DATA_VARIABLE}=DIR ({describe_lookup()})"
        raise DataError(f"{data_set.name}: {data_set.get}, {way_out}")
    for file_name, path in files.items() if not data_set.get else ():
        try:
            read_bytes(path, data_set=data_set)
        except DataError:
            if path != folder / file_name:
                raise
            absent.append(file_name)
    for file_name in absent:
        url, target = file_url(data_set, file_name), folder / file_name
        way_out = (
            f"Way out: get {' and '.join(data_set.sha256)} of that folder by any means,"
            f" save in DIR/{data_set.name} and set {DATA_VARIABLE}=DIR"
        )
        unchecked = folder / f".{file_name}.{os.getpid()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _remove_leftovers(folder, file_name)
            actual = _download(url, unchecked)
            if actual != data_set.sha256[file_name]:
                raise ValueError(  # noqa: TRY301 - see below
                    f"sha256 is {actual}, expected {data_set.sha256[file_name]}"
                )
            unchecked.replace(target)
        except (requests.RequestException, urllib3.exceptions.HTTPError) as error:
            raise DataError(f"{url}: {_reason(error)}. {way_out}") from None
        except OSError as error:
            reason = error.strerror or type(error).__name__
            raise DataError(f"{shown(target)}: cannot be written ({reason})") from None
        except ValueError as error:
            raise DataError(
                f"{url}: not the expected file: {error}. {way_out}"
            ) from None
        finally:
            with contextlib.suppress(OSError):
                unchecked.unlink()
        files[file_name] = target
    return files, bool(absent)


def _remove_leftovers(folder: Path, file_name: str) -> None:
    """Remove files left by killed downloads; a file's name ends with a process id."""
    for path in folder.glob(f".{file_name}.*"):
        process_id = path.name.rpartition(".")[2]
        if process_id.isdecimal():
            try:
                os.kill(int(process_id), 0)  # Only asks whether the process exists.
            except OSError:
                path.unlink(missing_ok=True)


def _reason(error: Exception) -> str:
    """Return in words why a download failed."""
    from requests import exceptions  # noqa: PLC0415 - as above
    from urllib3.exceptions import (  # noqa: PLC0415 - as above
        ProtocolError,
        ReadTimeoutError,
    )

    # requests has no Timeout for a server that falls silent in the middle.
    silent = "no answer in time"
    broken = (
        silent
        if "timed out" in str(error)
        else "no connection, or it broke off (offline?)"
    )
    status = getattr(getattr(error, "response", None), "status_code", "")
    reasons = {
        exceptions.HTTPError: f"the server answered {status}",
        exceptions.ProxyError: "the proxy refuses the connection",
        exceptions.SSLError: "no trusted connection (a proxy that opens TLS?)",
        ProtocolError: "the connection broke off",
        exceptions.Timeout: silent,
        ReadTimeoutError: silent,
        exceptions.ConnectionError: broken,
        Exception: f"cannot be downloaded ({type(error).__name__})",
    }
    return next(reason for kind, reason in reasons.items() if isinstance(error, kind))


def _answer(url: str) -> requests.Response:
    """Return a server's answer, its body still to come, within `LEAST_S`.

    The limits of requests count from byte to byte: header and redirections may trickle
    for ever.
    """
    import requests  # noqa: PLC0415 - as above

    answer: Future[requests.Response] = Future()

    def ask() -> None:
        # A body that requests unpacks could not be compared with its announced
        # length.
        headers = {"Accept-Encoding": "identity"}
        timeout_s = (CONNECT_TIMEOUT_S, READ_TIMEOUT_S)
        try:
            answer.set_result(
                requests.get(url, stream=True, timeout=timeout_s, headers=headers)
            )
        except Exception as error:  # noqa: BLE001 - raised again in the waiting thread
            answer.set_exception(error)

    Thread(target=ask, daemon=True).start()
    try:
        return answer.result(LEAST_S)
    except TimeoutError:
        raise requests.Timeout(f"timed out: over {LEAST_S:.0f} s") from None


def _download(url: str, into: Path) -> str:
    """Write the content of `url` to a file; return its sha256."""
    import requests  # noqa: PLC0415 - as above

    began_s, digest = time.monotonic(), hashlib.sha256()
    with _answer(url) as response, into.open("wb") as file:
        response.raise_for_status()
        print(f"downloading {url}", file=sys.stderr)  # noqa: T201 - it may take a while
        announced = response.headers.get("Content-Length", "")
        expected = (
            min(int(announced), _MOST_BYTES) if announced.isdecimal() else _MOST_BYTES
        )
        limit_s = LEAST_S + expected / LEAST_BYTES_PER_S
        # Read only available bytes: a slow server may never fill a whole chunk.
        while chunk := response.raw.read1(_CHUNK_BYTES):
            if time.monotonic() - began_s > limit_s:
                raise requests.Timeout(f"timed out: over {limit_s:.0f} s")
            file.write(chunk)
            digest.update(chunk)
            if file.tell() > _MOST_BYTES:
                raise ValueError(f"over {_MOST_BYTES} bytes")
    return digest.hexdigest()
