"""Linkers: the linkage attacks that a user or a preset names, and their tasks."""

from collections.abc import Iterable
from typing import Any

from attacks.tasks.task_list import FUSED, RETURNS, Task
from evaluation.plan.consumer import Consumer
from evaluation.plan.settings import Settings
from isac_track import plugins
from isac_track.errors import SettingsError
from isac_track.plugins import Plugin
from isac_track.protocols import attack_kind, grants, links_same_stretch
from isac_track.types import Knowledge


def parse_attacks(
    specs: Iterable[Any],
) -> tuple[tuple[Plugin, ...], tuple[Consumer, ...]]:
    """Return reconstruction attacks and linkage attacks, each once, as ordered."""
    attacks: dict[str, Plugin] = {}
    links: dict[str, Consumer] = {}
    for spec in specs:
        # A linker behind a reconstruction is two plug-ins, named by SPECs.
        if isinstance(spec, str) and "@" in spec:
            links |= {link.spec: link for link in _parse_linkers_behind(spec)}
            continue
        for plugin in plugins.resolve_plugins("attacks", spec):
            if attack_kind(plugin.instance) == "linkage":
                link = Consumer("linkage", plugin)
                links[link.spec] = link
            else:
                attacks[plugin.spec] = plugin
    return tuple(attacks.values()), tuple(links.values())


def _parse_linkers_behind(spec: str) -> list[Consumer]:
    """Return the linkers of LINKER@RECONSTRUCTION: several, if either is a sweep."""
    name, _, smoother = spec.partition("@")
    if not (name.strip() and smoother.strip()):
        raise SettingsError(
            f"{spec!r}: expected LINKER@RECONSTRUCTION, as shape@radial_rts"
        )
    links = []
    for linker in plugins.resolve_plugins("attacks", name):
        for reconstruction in plugins.parse("attacks", smoother):
            kinds = [
                attack_kind(attack.instance) for attack in (linker, reconstruction)
            ]
            if kinds[0] != "linkage" or kinds[1] == "linkage":
                raise SettingsError(
                    f"{spec!r}: write a linkage attack left of @ and a"
                    " reconstruction attack right of it, as in shape@radial_rts"
                )
            links.append(Consumer("linkage", linker, reconstruction=reconstruction))
    return links


def assign_links(
    settings: Settings,
    *,
    links: tuple[Consumer, ...],
    asked: tuple[Task, ...],
) -> tuple[tuple[Task, Consumer], ...]:
    """Return the linkers of each task; a linker that suits no task runs where it can.

    `asked` are the tasks of a run. That of people who come back has linkers of its own,
    so that these may be named without another task. Raises SettingsError for a linker
    or a task that a user names if they do not fit.
    """
    tasks = tuple(task for task in asked if task is not RETURNS)
    fused = FUSED if RETURNS in asked else ()
    tasks_by_link: dict[str, list[Task]] = {}
    _, named_links = parse_attacks(settings.choice("attacks").named)
    must_run = {link.spec for link in named_links}
    for link in links:
        possible = [
            task
            for task in tasks
            if granted_knowledge(link, task, settings.adversaries)
        ]
        tasks_by_link[link.spec] = _suited_tasks(link, possible) or possible
        if link.spec in must_run and not possible and link.spec not in fused:
            raise _no_task_error(link, tasks=tasks, fused=fused)
    must_link = settings.choice("tasks").named
    for task in tasks:
        if task.name in must_link and not any(
            task in link_tasks for link_tasks in tasks_by_link.values()
        ):
            raise SettingsError(
                f"task {task.name} has no attack that can run in it; name one with"
                " --attack"
            )
    return tuple(
        (task, link)
        for task in tasks
        for link in links
        if task in tasks_by_link[link.spec]
    )


def _suited_tasks(link: Consumer, possible: Iterable[Task]) -> list[Task]:
    """Return the tasks that a linker suits, of those where it can run.

    A linker that needs the true frame suits tasks that show it, and the others suit the
    other tasks. A linker that needs ``same_stretch`` of a walk, or a gap to bridge
    (``across_gap``), suits the tasks that have it.
    """
    linker = link.plugins[0].instance
    suited = [
        task
        for task in possible
        if task.shows_scene == (Knowledge.SCENE in linker.requires)
    ]
    if links_same_stretch(linker):
        suited = [task for task in suited if task.shows_same_steps]
    if getattr(linker, "across_gap", False):
        suited = [task for task in suited if task.is_open]
    return suited


def _no_task_error(
    link: Consumer, *, tasks: Iterable[Task], fused: Iterable[str]
) -> SettingsError:
    """Return the error of a linker that no task of a run grants what it requires."""
    required = (
        ", ".join(sorted(knowledge.name for knowledge in link.requires)) or "a task"
    )
    task_names = ", ".join(task.name for task in tasks) or "none"
    fused_names = ", ".join(fused)
    own = f"; task {RETURNS.name} has {fused_names} alone" if fused_names else ""
    return SettingsError(
        f"attack {link.spec!r} has no task to run in (tasks: {task_names}); it"
        f" requires {required}{own}"
    )


def granted_knowledge(
    link: Consumer, task: Task, asked: tuple[str, ...]
) -> dict[str, frozenset[Knowledge]]:
    """Return what each adversary with a linker is granted in a task, by its name.

    `asked` are adversaries beside the usual three. Empty where the linker cannot run.
    """
    return grants(
        link, everyone=task.granted_to_all, nobody=task.granted_to_none, asked=asked
    )
