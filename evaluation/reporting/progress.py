"""Progress of a run: the current step, the time that it took, and the time left."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import timedelta
from importlib import import_module
from typing import Final, TypeVar

from evaluation.reporting.amounts import counted, whole_percent

Item = TypeVar("Item")

# Time of the report as a share of that of the cells; measured: 11 to 13 %.
_REPORT: Final = 0.12
# Time and share of cells before which there is no estimate.
_LEAST_S, _LEAST_SHARE = 3.0, 0.03
# Shares at which a line is written if there is no terminal.
_MARKS: Final = (0.1, 0.5, 1.0)
_DISPLAY_S: Final = 0.2  # Between two updates of a notebook's display.
# Characters of the bar and of the step: with the times they fill 80 columns.
_BAR, _STEP = 10, 34


class Clock:
    """The time left of a run, from the speed at which its cells were finished.

    Cells of scenes and of linkage are computed by turns.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._begin, self._first, self._end = now(), (0.0, 0), 0.0

    def text(self, done: int, total: int) -> str:
        """Return the time since the start, and the time left if it can be estimated."""
        now = self._now()
        # The time before the first cell does not count: compiling happens once.
        if done and not self._first[1]:
            self._first = now, done
        since, n_first = self._first
        is_known = (
            now - since >= _LEAST_S and done - n_first >= _LEAST_SHARE * total > 0
        )
        if is_known and done < total:
            rest = (now - since) * (total - done) / (done - n_first)
            self._end = now + rest + _REPORT * (now - self._begin + rest)
        left = self._end - now
        text = _clock(now - self._begin)
        return f"{text}, about {_clock(left)} left" if left >= 1.0 else text


def _clock(seconds: float) -> str:
    """Return a duration as 1:02 or 1:02:03."""
    return f"{timedelta(seconds=round(seconds))}".removeprefix("0:").removeprefix("0")


def counting(items: Iterable[Item], *, total: int, noun: str) -> Iterator[Item]:
    """Yield items, with a line on standard error after each: `1 of 4 cards, 2:10`."""
    clock = Clock()
    for done, item in enumerate(items, start=1):
        passed, comma, left = clock.text(done, total).partition(", ")
        rest = f"{comma}{left}" if done < total else ""
        sys.stderr.write(f"{done} of {counted(total, noun)}, {passed}{rest}\n")
        sys.stderr.flush()
        yield item


@contextlib.contextmanager
def progress_bar(
    lines: list[str], *, heading: Sequence[str] = ()
) -> Iterator[Callable[[int, int | None, str], None]]:
    """Show the progress of a run below the lines of a heading.

    It is on standard error, and in a notebook in a display of its own. Lines that stay
    on the screen are added to `lines`.
    """
    if is_notebook():
        with _display(heading) as update:
            yield update
    else:
        sys.stderr.writelines(f"{line}\n" for line in heading)
        with _bar(lines) as update:
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
    """Show the progress of a run in an output of a notebook, updated in place."""
    show = import_module("IPython.display").display
    clock, last_s = Clock(), float("-inf")
    line = "starting"
    shown = show(_as_text([*heading, line]), raw=True, display_id=True)

    def update(done: int, total: int | None, step: str) -> None:
        nonlocal last_s, line
        text = clock.text(done, total or 0)
        filled = "#" * round(_BAR * done / total) if total else ""
        line = f"{step:<{_STEP}.{_STEP}} {filled:.<{_BAR}} {text}"
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
def _bar(lines: list[str]) -> Iterator[Callable[[int, int | None, str], None]]:
    """Show a bar on a terminal, or a few lines if standard error is no terminal."""
    from rich import progress  # noqa: PLC0415 - the user sees the first line sooner
    from rich.console import Console  # noqa: PLC0415 - as said

    console = Console(stderr=True, force_jupyter=False)
    clock, marks = Clock(), list(_MARKS)
    with progress.Progress(
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(bar_width=_BAR),
        progress.TextColumn("{task.fields[clock]}", markup=False),
        console=console,
        disable=not console.is_terminal,
        transient=True,
    ) as bar:
        task = bar.add_task("starting", total=None, clock="")

        def update(done: int, total: int | None, step: str) -> None:
            text = clock.text(done, total or 0)
            bar.update(
                task,
                completed=done,
                total=total,
                description=f"{step:<{_STEP}.{_STEP}}",
                clock=text,
            )
            share = done / total if total else 0.0
            is_due = (
                marks
                and share >= marks[0]
                and (share < 1.0 or step.startswith("report"))
            )
            if is_due and not console.is_terminal:
                while marks and share >= marks[0]:
                    del marks[0]
                part = "all cells" if share >= 1.0 else whole_percent(share)
                line = f"{part} after {text} ({step.partition(':')[0]})"
                lines.append(line)
                sys.stderr.write(f"{line}\n")

        yield update
