"""How long a plan will take, from measured rates of its parts: an estimate, for `--dry-run`."""

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np

from evaluation.compute.work import Block, LinkWork
from evaluation.plan.axes import Consumer
from evaluation.plan.plan import Plan
from evaluation.pool.pieces import cells_of, pieces_of, unfinished

RATES: Final = "rates.json"
"""CPU seconds by part on an idle machine: per million samples, or per million pairs of a task."""
_START_S: Final = 3.0  # Imports, and the first worker.
_REPORT_SHARE: Final = 0.12  # Of the time of the cells, as the progress bar has it.
_MINUTES_FROM_S: Final = 120.0  # Shorter ones are said in seconds.
_HOURS_FROM_S: Final = 7200.0
_REPORT_S: Final = 3.0  # Of the smallest run: tables, figures and page.


def expected_s(ready: Plan) -> float:
    """Return how long a plan will take, s, on as many idle cores as it has workers.

    Finished cells take no time. A plug-in of a user's own counts as the median of the
    built-in ones of its kind. Loops that are still to be compiled are not counted.
    """
    return wall_s(cells_cpu_s(ready), jobs=ready.jobs)


def wall_s(cpu_s: float, *, jobs: int) -> float:
    """Return how long a run takes whose cells take so many CPU seconds, s."""
    return _START_S + (1.0 + _REPORT_SHARE) * cpu_s / max(jobs, 1) + _REPORT_S


def cells_cpu_s(ready: Plan) -> float:
    """Return the CPU seconds of the cells that a plan misses."""
    missing = ready.units if ready.settings.fresh else unfinished(ready)
    rates, cpu_s = measured_rates(), 0.0
    for work in pieces_of(missing, ready):
        rate = rates[setup_of(work)]
        rate += sum(_rate(consumer, rates) for *_, consumer in cells_of(work))
        cpu_s += rate * size_of(work, ready)
    return cpu_s


def in_words(seconds: float, *, jobs: int) -> str:
    """Return a duration as it is said: `about 25 s on 2 cores`."""
    cores = "1 core" if jobs == 1 else f"{jobs} cores"
    if seconds < _MINUTES_FROM_S:
        return f"about {_rounded(seconds):.0f} s on {cores}"
    if seconds < _HOURS_FROM_S:
        return f"about {seconds / 60:.0f} min on {cores}"
    return f"about {seconds / 3600:.1f} h on {cores}"


def _rounded(seconds: float) -> float:
    """Return seconds to the nearest five: more digits are not known."""
    return 5.0 * max(round(seconds / 5.0), 1)


def size_of(work: Block | LinkWork, ready: Plan) -> float:
    """Return how much a consumer reads of a piece of work, in millions of samples or pairs."""
    if isinstance(work, Block):
        return work.order.size * float(np.diff(ready.tracks.offsets).mean()) / 1e6
    sides = (work.sessions.probe.search, work.sessions.gallery.search)
    probes, gallery = (
        np.bincount(side, minlength=len(work.sessions.searches)) for side in sides
    )
    return float(probes @ gallery) / 1e6


def setup_of(work: Block | LinkWork) -> str:
    """Return what the rate of all that is shared by the levels of a piece of work is called."""
    return "setup/scenes" if isinstance(work, Block) else "setup/linkage"


def name_of(consumer: Consumer) -> str:
    """Return what a consumer's rate is called: its kind and family, and what it runs behind."""
    families = "@".join(plugin.family for plugin in consumer.plugins)
    return f"{consumer.kind}/{families or consumer.control}".rstrip("/")


@cache
def measured_rates() -> Mapping[str, float]:
    """Return the measured CPU seconds by part, as `python -m benchmarks.rates` wrote them."""
    path = files("evaluation.pool") / RATES
    rates: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))
    return rates


def _rate(consumer: Consumer, rates: Mapping[str, float]) -> float:
    """Return a consumer's rate, or the median of its kind if it was not measured."""
    name = name_of(consumer)
    if name in rates:
        return rates[name]
    kind = f"{consumer.kind}/"
    return median(
        [rate for known, rate in rates.items() if known.startswith(kind)] or [0.0]
    )


def rates_path(root: Path) -> Path:
    """Return where a checkout keeps the measured rates."""
    return root / "evaluation" / "pool" / RATES
