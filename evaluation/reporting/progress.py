"""How far a run is: what is under way, how long it took, and how long it will take."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from importlib import import_module
from typing import Final

# What the report takes of the time of the cells, measured: 11 to 13 %.
_REPORT: Final = 0.12
_LEAST_S, _LEAST_SHARE = 3.0, 0.03  # Before, nobody can say how long it will take.
_MARKS: Final = (
    0.1,
    0.5,
    1.0,
)  # Shares at which a line is written where there is no terminal.
_DISPLAY_S: Final = 0.2  # Between two updates of a notebook's display.
_BAR, _WHAT = 10, 34  # Characters: with the times they fill 80 columns.


class Clock:
    """What is left of a run, from how fast its cells, scenes and links by turns, were finished."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._begin, self._first, self._end = now(), (0.0, 0), 0.0

    def text(self, done: int, total: int) -> str:
        """Return how long it took, and how long it will take if that can be said."""
        now = self._now()
        if (
            done and not self._first[1]
        ):  # what comes before, compiling for one, happens once
            self._first = now, done
        since, n_first = self._first
        is_known = (
            now - since >= _LEAST_S and done - n_first >= _LEAST_SHARE * total > 0
        )
        if is_known and done < total:
            rest = (now - since) * (total - done) / (done - n_first)
            self._end = now + rest + _REPORT * (now - self._begin + rest)
        left = self._end - now
        return f"{_clock(now - self._begin)}" + f", about {_clock(left)} left" * (
            left >= 1.0
        )


def _clock(seconds: float) -> str:
    """Return a duration as 1:02 or 1:02:03."""
    return f"{timedelta(seconds=round(seconds))}".removeprefix("0:").removeprefix("0")


@contextlib.contextmanager
def progress_bar(
    said: list[str], *, heading: Sequence[str] = ()
) -> Iterator[Callable[[int, int | None, str], None]]:
    """Show how far a run is, below the lines of a heading; lines that stay are added to `said`.

    That is on standard error, and in a notebook in a display of its own.
    """
    if is_notebook():
        with _display(heading) as update:
            yield update
    else:
        sys.stderr.writelines(f"{line}\n" for line in heading)
        with _bar(said) as update:
            yield update


def is_notebook() -> bool:
    """Whether this is the kernel of a notebook."""
    interactive = sys.modules.get("IPython")  # Imported by the kernel, if there is any.
    shell = interactive.get_ipython() if interactive else None
    return type(shell).__name__ == "ZMQInteractiveShell"


@contextlib.contextmanager
def _display(
    heading: Sequence[str],
) -> Iterator[Callable[[int, int | None, str], None]]:
    """Show how far a run is in an output of a notebook that is updated in place."""
    show = import_module("IPython.display").display
    clock, last_s = Clock(), float("-inf")
    line = "starting"
    shown = show(_as_text([*heading, line]), raw=True, display_id=True)

    def update(done: int, total: int | None, what: str) -> None:
        nonlocal last_s, line
        text = clock.text(done, total or 0)
        filled = "#" * round(_BAR * done / total) if total else ""
        line = f"{what:<{_WHAT}.{_WHAT}} {filled:.<{_BAR}} {text}"
        # A message for each of thousands of cells would keep the browser busy.
        if time.monotonic() - last_s >= _DISPLAY_S:
            last_s = time.monotonic()
            shown.update(_as_text([*heading, line]), raw=True)

    try:
        yield update
        line = f"done in {clock.text(0, 0)}"
    finally:
        shown.update(_as_text([*heading, line]), raw=True)


def _as_text(lines: Sequence[str]) -> dict[str, str]:
    return {"text/plain": "\n".join(lines)}


@contextlib.contextmanager
def _bar(said: list[str]) -> Iterator[Callable[[int, int | None, str], None]]:
    """Show a bar on a terminal, and a few lines where standard error is none."""
    from rich import progress  # noqa: PLC0415 - the user knows sooner what is under way
    from rich.console import Console  # noqa: PLC0415 - as said

    console, clock, marks = (
        Console(stderr=True, force_jupyter=False),
        Clock(),
        list(_MARKS),
    )
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
            is_due = (
                marks
                and share >= marks[0]
                and (share < 1.0 or what.startswith("report"))
            )
            if is_due and not console.is_terminal:
                while marks and share >= marks[0]:
                    del marks[0]
                said.append(
                    f"{100 * share:.0f} % after {text} ({what.partition(':')[0]})"
                )
                sys.stderr.write(f"{said[-1]}\n")

        yield update
