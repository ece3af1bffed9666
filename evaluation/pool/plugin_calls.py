"""Call every user's plug-in once before a run that computes with it."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from evaluation.compute.current_cell import Failure
from evaluation.compute.plugin_call import (
    PluginCall,
    PluginTime,
    check_and_time,
    check_plugin,
    defined_at,
    plugin_code,
)
from evaluation.compute.sharing import declared_knowledge
from evaluation.plan.consumer import Consumer
from evaluation.plan.origins import is_user_plugin
from evaluation.plan.plan import Plan
from evaluation.plan.units import Unit
from evaluation.plan.user_plugins import has_user_plugins
from evaluation.pool.pieces import missing_in_folder
from evaluation.pool.workers import spread
from evaluation.store.files import PLUGIN_ERROR, write_whole
from evaluation.store.folder import usable
from isac_track.errors import UNNAMED, PluginError
from isac_track.plugins import Plugin

# A call that takes longer is given up, and shows nothing about the plug-in.
MOST_S: Final = 60.0
# Cloudpickle's file name for code that it sent.
_TRAVELLED: Final = "<dynamic-code>"


@dataclass(frozen=True, slots=True)
class PluginTrial:
    """What calls of a user's plug-ins on a few made-up people showed."""

    given_up: list[str] = field(default_factory=list)
    """SPECs of the plug-ins whose call took too long."""
    times: dict[tuple[str, str], PluginTime] = field(default_factory=dict)
    """Times by kind and SPEC, where they were measured; a mechanism's kind is that."""
    untimed: list[str] = field(default_factory=list)
    """SPECs of the plug-ins without a time."""


def try_plugins(plan: Plan) -> list[str]:
    """Call every user's plug-in whose cells are missing; return those given up.

    Each is called in a worker that computes nothing of the run. A folder that holds a
    run stays as it is, except for the file with the traceback, which goes as soon as
    there is none.

    Raises PluginError if one fails, or takes longer than a cell may.
    """
    with usable(plan.out):
        if (plan.out / PLUGIN_ERROR).exists():
            (plan.out / PLUGIN_ERROR).unlink()
    call = partial(check_plugin, stages=plan.settings.stages)
    make_error = partial(_error_with_traceback, plan.out)
    return _call_plugins(plan, call, make_error=make_error).given_up


def time_plugins(plan: Plan) -> PluginTrial:
    """Call every user's plug-in whose cells are missing, and time it; write nothing.

    Raises as `try_plugins` does.
    """
    call = partial(check_and_time, stages=plan.settings.stages)
    return _call_plugins(plan, call, make_error=_error_without_traceback)


def _call_plugins(
    plan: Plan,
    call: Callable[[PluginCall], Iterable[tuple[str, str] | PluginTime]],
    *,
    make_error: Callable[[str, str], PluginError],
) -> PluginTrial:
    """Call the plug-ins, each in a worker; raise the error of the first that fails."""
    if not has_user_plugins(plan.axes):
        return PluginTrial()
    with usable(plan.out):
        missing = plan.units if plan.settings.fresh else missing_in_folder(plan)
    trial = PluginTrial()
    allowed_s = plan.settings.cell_timeout_s
    limit_s = MOST_S if allowed_s is None else min(allowed_s, MOST_S)
    works = deque(_list_calls(missing))
    called = [*works]
    for plugin_call, result in spread(
        call, works, jobs=1, limit_s=limit_s, in_workers=True, is_separate=True
    ):
        plugin = plugin_call.plugin
        if isinstance(result, PluginTime):
            trial.times[plugin_call.kind, plugin.spec] = result
        elif not isinstance(result, Failure):
            message, trace = result
            raise make_error(
                _located(message, plugin.instance), _located(trace, plugin.instance)
            )
        elif result.timed_out and limit_s != allowed_s:
            trial.given_up.append(plugin.spec)
        else:
            why = f"{result.message}{defined_at(plugin.instance)}"
            raise make_error(
                f"plug-in {plugin.spec!r}: {why}", "its process left no traceback"
            )
    trial.untimed.extend(
        dict.fromkeys(
            plugin_call.plugin.spec
            for plugin_call in called
            if (plugin_call.kind, plugin_call.plugin.spec) not in trial.times
        )
    )
    return trial


def _located(text: str, instance: Any) -> str:  # noqa: ANN401 - a user's object
    """Return a text with the file of a plug-in's code, whose name did not travel."""
    code = plugin_code(instance)
    if code is None or not Path(code.co_filename).is_file():
        return text.replace(
            _TRAVELLED, f"<{type(instance).__name__}, defined in the session>"
        )
    file = Path(code.co_filename)
    located = text.replace(_TRAVELLED, str(file))
    return located.replace(f"({UNNAMED}, ", f"({file.name}, ")


def _error_with_traceback(out: Path, why: str, trace: str) -> PluginError:
    """Write a traceback into the folder of a run; return the error that names it."""
    path = out / PLUGIN_ERROR
    write_whole(path, f"{why}\n\n{trace}\n".encode(errors="backslashreplace"))
    return PluginError(
        f"{why}; found by a call before the run, whose traceback is in {path}"
    )


def _error_without_traceback(why: str, _trace: str) -> PluginError:
    return PluginError(f"{why}; found by a call on a few made-up people")


def _is_called_elsewhere(plugin: Plugin, consumer: Consumer) -> bool:
    """Whether another consumer's call shows what a plug-in of this one does.

    A robot is called in scenes, too. A policy that answers from tracks is called where
    it answers from positions.
    """
    discloses = consumer.track_release or consumer.policy
    return discloses is not None and plugin is not discloses


def _list_calls(missing: Iterable[Unit]) -> list[PluginCall]:
    """Return a call per plug-in; an attack has the most knowledge that it gets."""
    calls: dict[tuple[str, str], PluginCall] = {}
    for unit in missing:
        if is_user_plugin(unit.mechanism):
            calls["mechanism", unit.mechanism.spec] = PluginCall(unit.mechanism)
        for consumer in unit.consumers.values():
            for plugin in filter(is_user_plugin, consumer.plugins):
                if _is_called_elsewhere(plugin, consumer):
                    continue
                caller = consumer
                if plugin is consumer.reconstruction:
                    caller = replace(
                        consumer,
                        kind="attack",
                        plugin=plugin,
                        reconstruction=None,
                        granted=consumer.granted & declared_knowledge(plugin),
                    )
                # Adversaries come in the order of `grants`: the last stays.
                calls[caller.kind, plugin.spec] = PluginCall(plugin, caller)
    return list(calls.values())
