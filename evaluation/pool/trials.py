"""The trial call of every stranger's plug-in that a run is to compute with, before it begins."""

from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from evaluation.compute.sharing import declared
from evaluation.compute.trial import Trial, attempted, code_of, defined_at
from evaluation.plan.fingerprint import has_strangers, is_strange
from evaluation.plan.plan import Plan, Unit
from evaluation.pool.pieces import unfinished
from evaluation.pool.workers import spread
from evaluation.store.files import PLUGIN_ERROR, write_whole
from evaluation.store.folder import usable
from isac_track.errors import UNNAMED, PluginError

# A call that takes longer is given up, and says nothing about the plug-in.
MOST_S: Final = 60.0
# Cloudpickle's name for the file of what it carried.
_TRAVELLED: Final = "<dynamic-code>"


def try_plugins(ready: Plan, *, keeps_traceback: bool = True) -> list[str]:
    """Call every stranger's plug-in of which something is missing; return those given up.

    Each is called in a worker that computes nothing of the run. A folder that holds a
    run stays as it is but for the file with the traceback, which goes as soon as there
    is none. Without `keeps_traceback` that is not written.

    Raises PluginError if one fails, or takes longer than a cell may.
    """
    with usable(ready.out):
        if (ready.out / PLUGIN_ERROR).exists():
            (ready.out / PLUGIN_ERROR).unlink()
        if not has_strangers(ready.axes):
            return []
        missing = ready.units if ready.settings.fresh else unfinished(ready)
    given_up = []
    allowed_s = ready.settings.cell_timeout_s
    limit_s = MOST_S if allowed_s is None else min(allowed_s, MOST_S)
    call = partial(attempted, stages=ready.settings.stages)
    failed = partial(_failed, ready) if keeps_traceback else _failed_without_trace
    works = deque(_trials(missing))
    for trial, found in spread(
        call, works, jobs=1, limit_s=limit_s, apart=True, alone=True
    ):
        for one in found:
            if isinstance(one, tuple):
                raise failed(*(_located(text, trial.plugin.instance) for text in one))
            if one.is_late and limit_s != allowed_s:
                given_up.append(trial.plugin.spec)
            else:
                why = (
                    f"plug-in {trial.plugin.spec!r}:"
                    f" {one.why}{defined_at(trial.plugin.instance)}"
                )
                raise failed(why, "its process left no traceback")
    return given_up


def _located(text: str, instance: Any) -> str:  # noqa: ANN401 - a stranger's
    """Return a text with what the code of an object's class travelled without: where it is from."""
    code = code_of(instance)
    if code is None or not Path(code.co_filename).is_file():
        return text.replace(
            _TRAVELLED, f"<{type(instance).__name__}, defined in the session>"
        )
    file = Path(code.co_filename)
    return text.replace(_TRAVELLED, str(file)).replace(
        f"({UNNAMED}, ", f"({file.name}, "
    )


def _failed(ready: Plan, why: str, trace: str) -> PluginError:
    """Keep a traceback in the folder of a run; return what is told."""
    path = ready.out / PLUGIN_ERROR
    write_whole(path, f"{why}\n\n{trace}\n".encode(errors="backslashreplace"))
    return PluginError(
        f"{why}; found by a call before the run, whose traceback is in {path}"
    )


def _failed_without_trace(why: str, _trace: str) -> PluginError:
    return PluginError(f"{why}; found by a call on a few made-up people")


def _trials(missing: Iterable[Unit]) -> list[Trial]:
    """Return what to call: each plug-in once, an attack as the adversary who is granted most."""
    found: dict[tuple[str, str], Trial] = {}
    for unit in missing:
        if is_strange(unit.mechanism):
            found["mechanism", unit.mechanism.spec] = Trial(unit.mechanism)
        for consumer in unit.consumers.values():
            for plugin in filter(is_strange, consumer.plugins):
                who = consumer
                if plugin is consumer.behind:
                    granted = consumer.granted & declared(plugin)
                    who = replace(
                        consumer,
                        kind="attack",
                        plugin=plugin,
                        behind=None,
                        granted=granted,
                    )
                # Blind comes before informed, and that before oracle.
                found[who.kind, plugin.spec] = Trial(plugin, who)
    return list(found.values())
