"""How far a run is: what is under way, how long it took, and how long it will take."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import Final

_REPORT: Final = 0.12  # What the report takes of the time of the cells, measured: 11 to 13 %.
_LEAST_S, _LEAST_SHARE = 3.0, 0.03  # Before, nobody can say how long it will take.
_MARKS: Final = (0.1, 0.5, 1.0)  # Shares at which a line is written where there is no terminal.
_BAR, _WHAT = 10, 34  # Characters: with the times they fill 80 columns.


class Clock:
    """What is left of a run, from how fast its cells, scenes and links by turns, were finished."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._begin, self._first, self._end = now(), (0.0, 0), 0.0

    def text(self, done: int, total: int) -> str:
        """Return how long it took, and how long it will take if that can be said."""
        now = self._now()
        if done and not self._first[1]:  # what comes before, compiling for one, happens once
            self._first = now, done
        since, n_first = self._first
        is_known = now - since >= _LEAST_S and done - n_first >= _LEAST_SHARE * total > 0
        if is_known and done < total:
            rest = (now - since) * (total - done) / (done - n_first)
            self._end = now + rest + _REPORT * (now - self._begin + rest)
        left = self._end - now
        return f"{_clock(now - self._begin)}" + f", about {_clock(left)} left" * (left >= 1.0)


def _clock(seconds: float) -> str:
    """Return a duration as 1:02 or 1:02:03."""
    return f"{timedelta(seconds=round(seconds))}".removeprefix("0:").removeprefix("0")


@contextlib.contextmanager
def progress_bar(said: list[str]) -> Iterator[Callable[[int, int | None, str], None]]:
    """Show on standard error how far a run is; lines that stay are added to `said`."""
    from rich import progress  # noqa: PLC0415 - the user knows sooner what is under way
    from rich.console import Console  # noqa: PLC0415 - as said

    is_notebook = Console().is_jupyter
    console, clock, marks = Console(stderr=True, force_jupyter=False), Clock(), list(_MARKS)
    with progress.Progress(
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(bar_width=_BAR),
        progress.TextColumn("{task.fields[clock]}", markup=False),
        console=console,
        disable=not console.is_terminal,
        transient=True,
    ) as bar:
        task = bar.add_task("starting", total=None, clock="")

        def update(done: int, total: int | None, what: str) -> None:
            text = clock.text(done, total or 0)
            told = f"{what:<{_WHAT}.{_WHAT}}"
            bar.update(task, completed=done, total=total, description=told, clock=text)
            share = done / total if total else 0.0
            if is_notebook:  # rich would need widgets there
                sys.stderr.write(f"\r{told} {'#' * round(_BAR * share):.<{_BAR}} {text:<28}")
                return
            is_due = marks and share >= marks[0] and (share < 1.0 or what.startswith("report"))
            if is_due and not console.is_terminal:
                while marks and share >= marks[0]:
                    del marks[0]
                said.append(f"{100 * share:.0f} % after {text} ({what.partition(':')[0]})")
                sys.stderr.write(f"{said[-1]}\n")

        yield update
        if is_notebook:
            sys.stderr.write("\n")
