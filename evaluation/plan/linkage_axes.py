"""The axes of linkage: tasks, their linkers, and people who come back."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import RETURNS, Task
from evaluation.plan.adversaries import Adversaries
from evaluation.plan.constants import OTHER_LAW
from evaluation.plan.consumer import Consumer, windows_consumer
from evaluation.plan.linkers import granted_knowledge
from evaluation.plan.presets import Preset
from evaluation.plan.scene_axes import SceneAxes
from evaluation.plan.settings import Settings
from evaluation.plan.world import World
from isac_track import plugins
from isac_track.plugins import Plugin


@dataclass(frozen=True, slots=True)
class LinkageAxes:
    """The linkers of each task, and the mechanisms whose releases they link.

    The task of people who come back is apart: a single consumer has all its linkers.
    """

    mechanisms: tuple[Plugin, ...] = ()
    """All mechanisms of a run, and `clean`: without any error every linker must succeed."""
    linkers_by_task: Mapping[Task, tuple[Consumer, ...]] = field(default_factory=dict)
    """Linkers of each task that has any, not yet of any adversary."""
    adversaries: Adversaries = field(default_factory=Adversaries)
    mechanisms_by_world: Mapping[World, tuple[Plugin, ...]] = field(
        default_factory=dict
    )
    """Mechanisms that are linked on walks of a model, too, by world."""
    has_returns: bool = False
    """Whether people who come back are linked."""
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Why linkage is left out: reasons by task, or by people of a task."""

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Tasks that have a linker, without people who come back."""
        return tuple(self.linkers_by_task)

    @property
    def all_linkers(self) -> tuple[Consumer, ...]:
        """Linkers of all tasks, each once, not yet of any task or adversary."""
        linkers = (linker for own in self.linkers_by_task.values() for linker in own)
        return tuple({linker.spec: linker for linker in linkers}.values())

    @property
    def model_tasks(self) -> tuple[Task, ...]:
        """Tasks that suit the walks of a model: in one stretch, without the scene."""
        return tuple(
            task
            for task in self.tasks
            if task.shows_same_steps and not task.shows_scene
        )

    def consumers(self, task: Task) -> tuple[Consumer, ...]:
        """Return all consumers of a task: windows, controls, linkers by adversary."""
        return (
            windows_consumer(task.name),
            *(
                Consumer("control", task=task.name, control=name)
                for name, control in CONTROLS.items()
                if control.applies(task)
            ),
            *self._linker_consumers(task),
        )

    @property
    def all_consumers(self) -> tuple[Consumer, ...]:
        """Consumers of all tasks, task by task."""
        return tuple(
            consumer for task in self.tasks for consumer in self.consumers(task)
        )

    def _linker_consumers(self, task: Task) -> tuple[Consumer, ...]:
        """Return every linker of a task, once for each adversary that runs it."""
        return tuple(
            replace(linker, adversary=adversary, granted=granted, task=task.name)
            for linker in self.linkers_by_task[task]
            for adversary, granted in self.adversaries.select(
                granted_knowledge(linker, task, self.adversaries.further)
            ).items()
        )

    def model_consumers(self, world: World, task: Task) -> tuple[Consumer, ...]:
        """Return the consumers of a task on walks of a model.

        They are the linkers, and the optimum, which knows the model.
        """
        consumers = (
            *self._linker_consumers(task),
            Consumer("link_bound", task=task.name),
        )
        return tuple(replace(consumer, world=world) for consumer in consumers)

    @property
    def return_consumers(self) -> tuple[Consumer, ...]:
        """Consumer of people who come back: all linkers and controls at once."""
        consumer = Consumer("returns", task=RETURNS.name, adversary="informed")
        return (consumer,) if self.has_returns else ()

    def with_skipped(self, reasons: Mapping[str, str]) -> "LinkageAxes":
        """Return the same axes with further reasons in `skipped`."""
        return replace(self, skipped={**self.skipped, **reasons})

    def without_returns(self) -> "LinkageAxes":
        """Return the axes without people who come back."""
        return replace(self, has_returns=False)

    def limited_to(self, tasks: Collection[Task]) -> "LinkageAxes":
        """Return the axes with some of the tasks."""
        linkers_by_task = {
            task: linkers
            for task, linkers in self.linkers_by_task.items()
            if task in tasks
        }
        return replace(self, linkers_by_task=linkers_by_task)

    def returns_alone(self) -> "LinkageAxes":
        """Return the axes of people who come back alone, without any other task."""
        return LinkageAxes(
            mechanisms=self.mechanisms,
            has_returns=self.has_returns,
            skipped=self.skipped,
        )


def expand_linkage(
    settings: Settings,
    preset: Preset,
    *,
    scenes: SceneAxes,
    mechanisms: tuple[Plugin, ...],
    linkers_by_task: Mapping[Task, tuple[Consumer, ...]],
    has_returns: bool,
) -> LinkageAxes:
    """Return the axes of linkage, with the adversaries and worlds of the scenes."""
    links_people = bool(linkers_by_task) or has_returns
    return LinkageAxes(
        mechanisms=_with_clean(mechanisms) if links_people else (),
        linkers_by_task=linkers_by_task,
        adversaries=scenes.adversaries,
        mechanisms_by_world=_linked_by_world(
            scenes.mechanisms_by_world, settings, preset
        ),
        has_returns=has_returns,
    )


def _with_clean(mechanisms: tuple[Plugin, ...]) -> tuple[Plugin, ...]:
    """Return mechanisms with `clean` in front, unless they have it."""
    (clean,) = plugins.parse("mechanisms", "clean")
    if clean.spec in {plugin.spec for plugin in mechanisms}:
        return mechanisms
    return (clean, *mechanisms)


def _linked_by_world(
    mechanisms_by_world: Mapping[World, tuple[Plugin, ...]],
    settings: Settings,
    preset: Preset,
) -> dict[World, tuple[Plugin, ...]]:
    """Return the mechanisms that are linked in other worlds, by world.

    These are walks of a model with Gaussian errors: elsewhere the optimum is not known.
    """
    run_law = settings.stages.sensing.law
    return {
        world: tuple(
            plugin
            for plugin in mechanisms
            if plugin.spec in preset.model_linked_mechanisms
        )
        for world, mechanisms in mechanisms_by_world.items()
        if world.is_model and (world.law or run_law) == OTHER_LAW
    }
