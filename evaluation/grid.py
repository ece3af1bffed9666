"""The axes of a run: presets, settings, and the levels and consumers that they expand to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, Literal

from isac_track import plugins as registry
from isac_track.config import StageSettings
from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from attacks.linkage.task_list import Task
    from isac_track.plugins import Plugin
    from isac_track.types import Knowledge

SHARED = "shared"
"""Consumer of the descriptors as shared."""
WINDOWS = "windows"
"""Consumer of the same of a linkage task, window by window, after the task."""
BLOCK_SCENES = 250
"""Scenes of a cell. Part of the keys of the sharing streams: a change changes the draws."""


MOST_SCENES = 10_000_000


@dataclass(frozen=True, slots=True)
class Preset:
    """Axes that a name stands for."""

    scenes: int
    mechanisms: tuple[str, ...]
    predictors: tuple[str, ...]
    attacks: tuple[str, ...]
    tasks: tuple[str, ...]
    summary: str


_SWEEP = (
    "raw",
    *(
        f"{axis}{rule}"
        for rule in ("", ",adding=independent")
        for axis in ("fid:1..1000/10", "fid:1e4", "fid:1e5", "fid:1e6", "fixed:0.1..1/10")
    ),
)
# What moves the descriptors and what can be linked apart from each other. The levels were chosen by
# PLR, AEL and MEL as shared alone, before anything was linked: those of correlated and offset lie
# within the range from raw to fixed:1 (offset:0.4 does not). Thinned, a sample stands for longer.
DISSOCIATION = (
    "correlated:0.75",
    "correlated:0.75,adding=independent",
    "offset:0.3",
    "thin:4",
    "thin:4,d_sigma=0.75",
    "thin:4,d_sigma=0.75,adding=independent",
)
"""Controls of the question whether a descriptor tells how linkable people are."""
_PREDICTORS = ("least_squares", "kalman_cv", "kalman_ca", "kalman_imm")
# All built-in ones but the slow: imm_rts and gaussian_process run when named.
_RECONSTRUCTIONS = (
    "identity",
    "moving_average",
    "savgol",
    "kalman_rts",
    "radial_rts",
    "averaging",
)
# Every linker as it is, and behind the stronger smoother where that gains more than it costs. All
# else runs when named: shape@kalman_rts, dtw@radial_rts.
_LINKS = (
    "shape",
    "shape@radial_rts",
    "profile",
    "profile@radial_rts",
    "dtw",
    "behaviour",
    "histogram",
    "kinematic",
    "kinematic@radial_rts",
)
_ATTACKS = (*_RECONSTRUCTIONS, *_LINKS)
_TASKS = ("rerelease", "split", "handover-1s", "handover-2s", "handover-5s", "new_traversal")
PRESETS = {
    "smoke": Preset(
        scenes=40,
        mechanisms=("raw", "fid:1", "fid:1000", "fixed:0.7", "fixed:1"),
        predictors=_PREDICTORS,
        attacks=_ATTACKS,
        tasks=_TASKS,
        summary="40 scenes, the 5 levels that the paper gives numbers for",
    ),
    "paper": Preset(
        scenes=500,
        mechanisms=(*_SWEEP, *DISSOCIATION),
        predictors=_PREDICTORS,
        attacks=_ATTACKS,
        tasks=_TASKS,
        summary="500 scenes, raw, 13 eta, 10 fixed errors, both adding rules, 6 controls",
    ),
    "full": Preset(
        scenes=5000,
        mechanisms=(*_SWEEP, *DISSOCIATION),
        predictors=_PREDICTORS,
        attacks=_ATTACKS,
        tasks=_TASKS,
        summary="the axes of paper on 5,000 scenes",
    ),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """A whole run. None means: as the preset, the lookup or the default folder says."""

    preset: str = "paper"
    dataset: str | None = None
    """Name of a known data set, or a path."""
    format: str | None = None
    fps: float | None = None
    scenes: int | None = None
    seed: int = 0
    mechanisms: tuple[str, ...] | None = None
    """SPECs; they replace the preset's."""
    predictors: tuple[str, ...] | None = None
    """SPECs; they replace the preset's. Empty: no predictor."""
    attacks: tuple[str, ...] | None = None
    """SPECs, LINKER@RECONSTRUCTION among them; they replace the preset's. Empty: no attack."""
    tasks: tuple[str, ...] | None = None
    """Linkage tasks; they replace the preset's. Empty: nothing is linked."""
    stages: StageSettings = field(default_factory=StageSettings)
    jobs: int | None = None
    """Worker processes; None: as many as there are cores where the work is worth it."""
    cell_timeout_s: float | None = None
    """Longest time that a cell may take; one that takes longer is killed and left out."""
    executor: str = "local"
    """Or dask: the workers of a Dask cluster."""
    scheduler: str | None = None
    """Address of the cluster's scheduler."""
    out: Path | str | None = None
    fresh: bool = False

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            near = get_close_matches(self.preset, PRESETS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(PRESETS)}"
            raise SettingsError(f"unknown preset {self.preset!r}; {hint}")
        if self.scenes is not None and not 2 <= self.scenes <= MOST_SCENES:  # noqa: PLR2004
            raise SettingsError(
                f"a run needs at least 2 scenes (one of each label) and at most {MOST_SCENES:,}, "
                f"got {self.scenes}"
            )
        if self.seed < 0:
            raise SettingsError(f"the seed must not be negative, got {self.seed}")
        if self.jobs is not None and self.jobs < 1:
            raise SettingsError(f"jobs must be at least 1, got {self.jobs}")
        if self.cell_timeout_s is not None and not self.cell_timeout_s > 0:
            raise SettingsError(f"cell_timeout must be positive, got {self.cell_timeout_s:g} s")
        if self.fps is not None and not self.fps > 0:
            raise SettingsError(f"fps must be positive, got {self.fps:g}")
        self._check_executor()

    def _check_executor(self) -> None:
        if self.executor not in ("local", "dask"):
            raise SettingsError(f"the executor is local or dask, got {self.executor!r}")
        if self.executor == "local":
            if self.scheduler is not None:
                raise SettingsError("--scheduler ADDRESS goes with --executor dask")
            return
        if not self.scheduler:
            raise SettingsError(
                "--executor dask needs --scheduler ADDRESS, as tcp://host:8786; "
                "`dask scheduler` starts one and tells its address"
            )
        if self.jobs is not None:
            raise SettingsError("--jobs is of --executor local: a cluster has the workers it has")
        if self.cell_timeout_s is not None:
            raise SettingsError(
                "--cell-timeout is of --executor local: limits of a cluster are its own"
            )

    @property
    def n_scenes(self) -> int:
        """Scenes of the run."""
        return PRESETS[self.preset].scenes if self.scenes is None else self.scenes


@dataclass(frozen=True, slots=True)
class Link:
    """A linkage attack, as it is or behind a reconstruction: smooth, then link."""

    linker: Plugin
    behind: Plugin | None = None

    @property
    def spec(self) -> str:
        """LINKER or LINKER@RECONSTRUCTION."""
        return self.linker.spec + ("" if self.behind is None else f"@{self.behind.spec}")

    @property
    def requires(self) -> frozenset[Knowledge]:
        """What either of the two cannot run without."""
        return frozenset().union(*(one.instance.requires for one in self._parts))

    @property
    def uses(self) -> frozenset[Knowledge]:
        """What either of the two takes if granted."""
        return frozenset().union(*(one.instance.uses for one in self._parts))

    @property
    def _parts(self) -> tuple[Plugin, ...]:
        return (self.linker,) if self.behind is None else (self.linker, self.behind)


@dataclass(frozen=True, slots=True)
class Consumer:
    """Who reads a release: a predictor, an adversary, or nobody (the descriptors as shared)."""

    kind: Literal["shared", "predictor", "attack", "linkage", "control", "windows"]
    plugin: Plugin | None = None
    knowledge: str = ""
    """Adversary that the row is named after: blind, informed or oracle."""
    granted: frozenset[Knowledge] = frozenset()
    task: str = ""
    """Of a linkage attack, a control, or the descriptors of what is linked."""
    behind: Plugin | None = None
    """Reconstruction that a linkage attack runs behind."""
    control: str = ""

    @property
    def spec(self) -> str:
        """As in the column `consumer`."""
        if self.kind == "control":
            return f"{self.task}/control-{self.control}"
        if self.kind == "windows":
            return f"{self.task}/{WINDOWS}"
        if self.plugin is None:
            return SHARED
        if self.kind == "linkage":
            return f"{self.task}/{Link(self.plugin, self.behind).spec}"
        return self.plugin.spec

    @property
    def is_slow(self) -> bool:
        """Whether it runs on the first release of each source track only."""
        return self.plugin is not None and bool(getattr(self.plugin.instance, "slow", False))

    @property
    def is_built_in(self) -> bool:
        """Whether an attack is one of the project's own."""
        return self.plugin is not None and self.plugin.origin.startswith("attacks.")

    @property
    def label(self) -> str:
        """For people: with the adversary."""
        return f"{self.spec} ({self.knowledge})" if self.knowledge else self.spec


@dataclass(frozen=True, slots=True)
class Axes:
    """What the run crosses: every mechanism level with every consumer."""

    mechanisms: tuple[Plugin, ...]
    predictors: tuple[Plugin, ...]
    attacks: tuple[Plugin, ...]
    """Reconstruction attacks."""
    links: tuple[tuple[Task, Link], ...] = ()
    """Who links in which task."""
    ceiling: Plugin | None = None
    """Mechanism without any error, at which every linkage attack must succeed."""
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Tasks of the preset that the recording is too small for, and why."""

    @property
    def consumers(self) -> tuple[Consumer, ...]:
        """All consumers of a block of scenes: the descriptors first, attacks by adversary."""
        from isac_track.protocols import grants  # noqa: PLC0415 - --help needs no numpy

        return (
            Consumer("shared"),
            *(Consumer("predictor", plugin) for plugin in self.predictors),
            *(
                Consumer("attack", plugin, knowledge=adversary, granted=granted)
                for plugin in self.attacks
                for adversary, granted in grants(plugin.instance).items()
            ),
        )

    @property
    def linked_mechanisms(self) -> tuple[Plugin, ...]:
        """Return the mechanisms of the linkage tasks: all, and the ceiling."""
        known = {plugin.spec for plugin in self.mechanisms}
        extra = () if self.ceiling is None or self.ceiling.spec in known else (self.ceiling,)
        return (*extra, *self.mechanisms)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Tasks in which somebody links."""
        return tuple(dict.fromkeys(task for task, _ in self.links))

    def readers(self, task: Task) -> tuple[Consumer, ...]:
        """Return all consumers of a task: the descriptors of its windows, then who links."""
        return (Consumer("windows", task=task.name), *self.linkers(task))

    def linkers(self, task: Task) -> tuple[Consumer, ...]:
        """Return who links in a task: the controls, then the attacks by adversary."""
        from attacks.controls import CONTROLS  # noqa: PLC0415 - as above
        from isac_track.protocols import grants  # noqa: PLC0415

        return (
            *(
                Consumer("control", task=task.name, control=name)
                for name, control in CONTROLS.items()
                if control.applies(task)
            ),
            *(
                Consumer(
                    "linkage",
                    link.linker,
                    knowledge=adversary,
                    granted=granted,
                    task=task.name,
                    behind=link.behind,
                )
                for where, link in self.links
                if where is task
                for adversary, granted in grants(
                    link, everyone=task.everyone, nobody=task.nobody
                ).items()
            ),
        )

    def without(self, task: Task, why: str) -> Axes:
        """Return the axes without a task that cannot be."""
        return replace(
            self,
            links=tuple(pair for pair in self.links if pair[0] is not task),
            skipped={**self.skipped, task.name: why},
        )


def axes(settings: Settings) -> Axes:
    """Return the plug-ins of a run, each once.

    Raises
    ------
    SettingsError
        If a SPEC is wrong, no mechanism is left, or a task and the attacks do not fit.
    PluginError
        If a named plug-in cannot be loaded.
    """
    preset = PRESETS[settings.preset]
    mechanisms = preset.mechanisms if settings.mechanisms is None else settings.mechanisms
    predictors = preset.predictors if settings.predictors is None else settings.predictors
    attacks, links = _attacks(preset.attacks if settings.attacks is None else settings.attacks)
    expanded = Axes(
        mechanisms=registry.parse_all("mechanisms", mechanisms),
        predictors=registry.parse_all("predictors", predictors),
        attacks=attacks,
        links=_linked(settings, links=links, tasks=_tasks(settings)),
    )
    if not expanded.mechanisms:
        raise SettingsError("nothing to run: the mechanism axis is empty; name one, such as raw")
    if expanded.links:
        (ceiling,) = registry.parse("mechanisms", "clean")
        expanded = replace(expanded, ceiling=ceiling)
    return expanded


def _attacks(specs: tuple[str, ...]) -> tuple[tuple[Plugin, ...], tuple[Link, ...]]:
    """Return reconstruction attacks and linkage attacks, each once, in the order given."""
    if not specs:
        return (), ()
    from isac_track.protocols import kind_of  # noqa: PLC0415 - --help needs no numpy

    attacks: dict[str, Plugin] = {}
    links: dict[str, Link] = {}
    for spec in specs:
        name, at, behind_spec = spec.partition("@")
        if at and not (name.strip() and behind_spec.strip()):
            raise SettingsError(f"{spec!r}: expected LINKER@RECONSTRUCTION, as shape@radial_rts")
        for plugin in registry.parse("attacks", name):
            links_people = kind_of(plugin.instance) == "linkage"
            if not at:
                if links_people:
                    links[plugin.spec] = Link(plugin)
                else:
                    attacks[plugin.spec] = plugin
                continue
            for behind in registry.parse("attacks", behind_spec):
                if not links_people or kind_of(behind.instance) == "linkage":
                    raise SettingsError(
                        f"{spec!r}: left of @ stands a linkage attack, right of it the "
                        "reconstruction that it runs behind, as in shape@radial_rts"
                    )
                link = Link(plugin, behind)
                links[link.spec] = link
    return tuple(attacks.values()), tuple(links.values())


def _tasks(settings: Settings) -> tuple[Task, ...]:
    from attacks.linkage.task_list import TASKS  # noqa: PLC0415 - --help needs no numpy

    names = PRESETS[settings.preset].tasks if settings.tasks is None else settings.tasks
    for name in names:
        if name not in TASKS:
            near = get_close_matches(name, TASKS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(TASKS)}"
            raise SettingsError(f"unknown task {name!r}; {hint}")
    return tuple(TASKS[name] for name in dict.fromkeys(names))


def _linked(
    settings: Settings, *, links: tuple[Link, ...], tasks: tuple[Task, ...]
) -> tuple[tuple[Task, Link], ...]:
    """Return who links in which task.

    Who needs the true frame links where it shows, the others where it does not; an attack that
    none of the tasks suits is run in every one that it can run in.
    """
    from isac_track.protocols import grants  # noqa: PLC0415 - --help needs no numpy
    from isac_track.types import Knowledge  # noqa: PLC0415

    chosen: dict[str, list[Task]] = {}
    for link in links:
        can = [task for task in tasks if grants(link, everyone=task.everyone, nobody=task.nobody)]
        needs_scene = Knowledge.SCENE in link.linker.instance.requires
        chosen[link.spec] = [task for task in can if task.shows_scene == needs_scene] or can
    pairs = [(task, link) for task in tasks for link in links if task in chosen[link.spec]]
    for link in links:
        if settings.attacks is not None and all(one is not link for _, one in pairs):
            asked = ", ".join(sorted(one.name for one in link.requires)) or "a task"
            where = ", ".join(task.name for task in tasks) or "none"
            raise SettingsError(
                f"attack {link.spec!r} has no task to run in (tasks: {where}); it requires {asked}"
            )
    for task in tasks:
        if settings.tasks is not None and all(one is not task for one, _ in pairs):
            raise SettingsError(
                f"task {task.name} has no attack that can run in it; name one with --attack"
            )
    return tuple(pairs)


def n_blocks(n_scenes: int) -> int:
    """Return how many blocks of scenes a run has."""
    return -(-n_scenes // BLOCK_SCENES)
