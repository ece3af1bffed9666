"""Fuzz the readers of recordings: `python -m benchmarks.fuzz_readers --minutes 10`.

Needs atheris (libFuzzer for Python), which is no part of the test extra. Every format
gets an equal share of the time, in a process of its own, from the small files in
``tests/fuzz/corpus``. A reader gives tracks or an `IsacTrackError` of one line that
names the file; any other exception, any warning, 10 s or 1 GB is a finding, and its
input is kept under ``--out``.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import warnings
from importlib.util import find_spec
from pathlib import Path

CORPUS = Path(__file__).parent.parent / "tests" / "fuzz" / "corpus"
SEEDS = {
    "obsmat": ["walks.obsmat"],
    "social-gan": ["walks.social-gan"],
    "pedpy": ["walks.pedpy"],
    "trajnet": ["walks.trajnet"],
    "csv": ["walks.csv"],
    "parquet": ["text.parquet", "number.parquet"],
}
TIMEOUT_S = 10
MEMORY_MB = 1024
LARGEST_BYTES = 4096


def main() -> int:
    """Fuzz and print a line for each format.

    Returns 0, 1 with findings, or 2 without atheris.
    """
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fuzz_readers", description=__doc__
    )
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="in all (default 10)"
    )
    parser.add_argument(
        "--format", choices=SEEDS, action="append", help="only this (repeatable)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("runs/fuzz"), help="folder of findings"
    )
    parser.add_argument(
        "--in-process", nargs=argparse.REMAINDER, help=argparse.SUPPRESS
    )
    options = parser.parse_args()
    if find_spec("atheris") is None:
        print(
            "error: needs atheris: python -m pip install atheris (Linux)",
            file=sys.stderr,
        )
        return 2
    formats = options.format or list(SEEDS)
    if options.in_process is not None:
        _fuzz(formats[0], options.in_process)
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"{'format':<12}{'inputs':>10}{'edges':>8}{'corpus':>8}{'MB':>6}  finding")
    codes = [
        _run(name, seconds=60 * options.minutes / len(formats), out=options.out)
        for name in formats
    ]
    return int(any(codes))


def _run(format_name: str, *, seconds: float, out: Path) -> int:
    """Fuzz a format in a process of its own, which libFuzzer ends; print the result."""
    with tempfile.TemporaryDirectory() as folder:
        seeds = Path(folder) / "corpus"
        seeds.mkdir()
        for name in SEEDS[format_name]:
            (seeds / name).write_bytes((CORPUS / name).read_bytes())
        prefix = (out / f"{format_name}-").resolve()
        command = [
            sys.executable,
            "-m",
            "benchmarks.fuzz_readers",
            "--format",
            format_name,
            "--in-process",
            str(seeds),
            f"-max_total_time={max(1, round(seconds))}",
            f"-timeout={TIMEOUT_S}",
            f"-rss_limit_mb={MEMORY_MB}",
            f"-max_len={LARGEST_BYTES}",
            f"-artifact_prefix={prefix}",
            "-print_final_stats=1",
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    inputs, memory = (
        next(iter(re.findall(rf"stat::{name}:\s+(\d+)", done.stderr)), "?")
        for name in ("number_of_executed_units", "peak_rss_mb")
    )
    coverage = re.findall(r"cov: (\d+).*?corp: (\d+)", done.stderr)
    edges, corpus = coverage[-1] if coverage else ("?", "?")
    finding = ", ".join(re.findall(r"Test unit written to (\S+)", done.stderr))
    if not finding and done.returncode != 0:
        finding = done.stderr.strip()[-300:]
    print(
        f"{format_name:<12}{inputs:>10}{edges:>8}{corpus:>8}{memory:>6}  {finding}",
        flush=True,
    )
    return done.returncode


def _fuzz(format_name: str, arguments: list[str]) -> None:
    """Hand the process over to libFuzzer; does not return."""
    import atheris  # noqa: PLC0415 - not installed with the project

    with atheris.instrument_imports(include=["isac_track.datasets"]):
        from isac_track import datasets  # noqa: PLC0415 - instrumented here
    from isac_track.errors import IsacTrackError  # noqa: PLC0415 - after the above

    warnings.simplefilter("error")
    file = Path(arguments[0]).with_name("file")

    def read_input(data: bytes) -> None:
        for fps in (None, 25.0):
            try:
                datasets.read(data=data, path=str(file), format=format_name, fps=fps)
            except IsacTrackError as error:
                message = str(error)
                if str(file) not in message or len(message.splitlines()) != 1:
                    raise AssertionError(message) from error

    for seed in Path(arguments[0]).iterdir():
        # Late imports must not count for the time of an input.
        read_input(seed.read_bytes())
    atheris.Setup([sys.argv[0], *arguments], read_input)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
