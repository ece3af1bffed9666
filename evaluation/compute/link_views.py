"""What linkers see of a linkage task at one mechanism level.

Equal releases are the same objects, so that linkers remember what they make of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from attacks.remembered import record_shared, select_tracks
from evaluation.compute import sharing
from evaluation.compute.frames import hide_sigma
from evaluation.compute.guards import copy_for_user_plugin, guarded
from evaluation.compute.link_setup import SIDES, Pairing, SensedTask
from evaluation.compute.sharing import call_attack, declared_knowledge
from evaluation.plan.origins import is_user_plugin
from isac_track.protocols import AttackContext, LinkageTrainingSet, TrainingSet
from isac_track.rng import stream
from isac_track.types import Floats, Knowledge, Release, derived

if TYPE_CHECKING:
    from attacks.tasks.windows import Windows
    from evaluation.plan.consumer import Consumer
    from isac_track.plugins import Plugin


@dataclass(frozen=True, eq=False, slots=True)
class LinkerView:
    """Both releases as some linkers see them, and the windows of pairings so far."""

    releases: tuple[Release, ...]
    # (M,) m of either release, as the reconstruction in front claims.
    claimed_std: tuple[Floats | None, ...] = ()
    windows: dict[int, tuple[Release, Release]] = field(default_factory=dict)
    """A memo by the id of the pairing; `LinkedLevel.forget_views` empties it."""

    def pair_windows(self, pairing: Pairing) -> tuple[Release, Release]:
        """Return the windows of a pairing, the same objects every time."""
        if id(pairing) not in self.windows:
            probe, gallery = self.releases
            self.windows[id(pairing)] = (
                select_tracks(probe, pairing.probe),
                select_tracks(gallery, pairing.gallery),
            )
        return self.windows[id(pairing)]


@dataclass(frozen=True, slots=True)
class _ViewKey:
    """What a smoothed view of a level depends on."""

    shows_sigma: bool
    reconstruction: str
    granted: frozenset[Knowledge]  # To the reconstruction.
    fold: int | None  # None for a view that is the same in both folds.


@dataclass(frozen=True, eq=False, slots=True)
class LinkedLevel:
    """All that the consumers of a linkage task share at one mechanism level."""

    mechanism: Plugin
    full_setup: SensedTask  # With all samples.
    # Without the samples that were left out; `full_setup` itself if none were.
    setup: SensedTask
    # Of the probe and of the gallery side, in the true frame.
    shared: tuple[Release, ...]
    blind: LinkerView  # In the frames of the adversary, without standard deviations.
    seen: LinkerView  # In the same frames, with the declared standard deviations.
    views: dict[_ViewKey, LinkerView] = field(default_factory=dict)
    """A memo of smoothed views; `forget_views` empties it."""

    def forget_views(self) -> None:
        """Drop all windows and smoothed views, and what linkers remember of them."""
        self.views.clear()
        self.blind.windows.clear()
        self.seen.windows.clear()

    def view_for(self, granted: frozenset[Knowledge]) -> LinkerView:
        """Return both releases as they show, the same objects every time."""
        return self.seen if Knowledge.SIGMA in granted else self.blind

    def context(
        self,
        granted: frozenset[Knowledge],
        *names: str | int,
        train: TrainingSet | LinkageTrainingSet | None = None,
    ) -> AttackContext:
        """Return the context of an attack with knowledge; `names` are of its stream."""
        return AttackContext(
            rng=stream(self.setup.seed, *names),
            epsilon_m=self.setup.privacy.epsilon_m,
            granted=granted,
            mechanism=self.mechanism.instance,
            train=train,
        )


def linked_level(mechanism: Plugin, full_setup: SensedTask) -> LinkedLevel:
    """Return the releases of both sides of a task under a mechanism."""
    family = full_setup.task_windows.task.family
    setup, shared, seen = full_setup, [], list[Release]()
    for number, (side, sensed) in enumerate(zip(SIDES, full_setup.sensed, strict=True)):
        release = sharing.share(
            mechanism, sensed, "linkage", family, side, seed=full_setup.seed
        )
        samples = sharing.samples_shared(release, sensed)
        if samples is not None:
            windows = sharing.take_samples(
                getattr(full_setup.task_windows, side), samples
            )
            setup = replace(
                setup, task_windows=replace(setup.task_windows, **{side: windows})
            )
        shared.append(release)
        if full_setup.frames:
            frame = full_setup.frames[number].per_sample(release.offsets)
            release = frame.release(release)
        seen.append(release)
    return LinkedLevel(
        mechanism=mechanism,
        full_setup=full_setup,
        setup=setup,
        shared=tuple(shared),
        blind=LinkerView(tuple(release.without_sigma() for release in seen)),
        seen=LinkerView(tuple(seen)),
    )


def level_of_releases(
    mechanism: Plugin, setup: SensedTask, releases: tuple[Release, ...]
) -> LinkedLevel:
    """Return a level of releases of both sides, made already, in their frames."""
    return LinkedLevel(
        mechanism=mechanism,
        full_setup=setup,
        setup=setup,
        shared=releases,
        blind=LinkerView(tuple(release.without_sigma() for release in releases)),
        seen=LinkerView(releases),
    )


def view_key(consumer: Consumer) -> tuple[str, str]:
    """Return the smoother before a linker, and its knowledge: equal keys, equal views.

    Consumers are sorted by it, so that the memory holds the releases of one key only.
    """
    if consumer.reconstruction is None:
        return "", ""
    granted = consumer.granted & declared_knowledge(consumer.reconstruction)
    return consumer.reconstruction.spec, ",".join(sorted(item.name for item in granted))


def linker_view(consumer: Consumer, level: LinkedLevel, fold: int) -> LinkerView:
    """Return both releases as a linker sees them: smoothed behind a smoother."""
    reconstruction, shows = consumer.reconstruction, consumer.granted
    if consumer.plugin is not None:
        shows &= declared_knowledge(consumer.plugin)
    if reconstruction is None:
        return level.view_for(shows)
    granted = consumer.granted & declared_knowledge(reconstruction)
    # Built-in attacks draw nothing: without training they are the same in both folds.
    may_draw = is_user_plugin(reconstruction)
    is_same_in_folds = Knowledge.TRAIN not in granted and not may_draw
    key = _ViewKey(
        shows_sigma=Knowledge.SIGMA in shows,
        reconstruction=reconstruction.spec,
        granted=granted,
        fold=None if is_same_in_folds else fold,
    )
    if key not in level.views:
        smoothed = _smoothed_view(consumer, reconstruction, level, fold, shows)
        # The smoother may choose equally in both folds: share the earlier view, so that
        # linkers compute their descriptors of a release once.
        equal_views = (
            view
            for view in level.views.values()
            if _are_same(view.releases, smoothed.releases)
        )
        level.views[key] = next(equal_views, smoothed)
    return level.views[key]


def _are_same(releases: Iterable[Release], others: Iterable[Release]) -> bool:
    """Whether releases of one level hold the very same arrays."""
    return all(
        release.xy is other.xy
        and release.sigma is other.sigma
        and release.cov is other.cov
        for release, other in zip(releases, others, strict=True)
    )


def _smoothed_view(
    consumer: Consumer,
    reconstruction: Plugin,
    level: LinkedLevel,
    fold: int,
    shows: frozenset[Knowledge],
) -> LinkerView:
    """Return both releases with the positions that a reconstruction estimates."""
    name, setup = f"attack {reconstruction.spec} (behind {consumer.label})", level.setup
    granted = consumer.granted & declared_knowledge(reconstruction)
    view = level.view_for(granted)
    training, train = setup.folds[fold].training, None
    if training.probe.size:
        samples = sharing.track_samples(
            setup.task_windows.probe.offsets, training.probe
        )
        truth = true_walks(level, 0)[samples.rows]
        probe, _ = view.pair_windows(training)
        train = TrainingSet(copy_for_user_plugin(probe, reconstruction), truth)
    names = ("attacks", reconstruction.spec, "linkage", level.mechanism.spec, fold)
    context = level.context(granted, *names, train=train)
    attack = guarded(name, lambda: reconstruction.instance.fit(context))
    smoothed, claimed_std = list[Release](), []
    for release, visible in zip(level.seen.releases, view.releases, strict=True):
        result = call_attack(
            attack, copy_for_user_plugin(visible, reconstruction), name=name
        )
        smooth = hide_sigma(derived(release, xy=result.xy), shows)
        smoothed.append(record_shared(smooth, visible))
        claimed_std.append(result.std)
    return LinkerView(tuple(smoothed), tuple(claimed_std))


def true_walks(level: LinkedLevel, side: int) -> Floats:
    """Return the true positions of a side, (M, 2) m, in the adversary's frames."""
    windows: Windows = getattr(level.setup.task_windows, SIDES[side])
    frames = level.setup.frames
    if not frames:
        return windows.xy
    return frames[side].per_sample(windows.offsets).points(windows.xy)
