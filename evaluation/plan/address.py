"""The address of a number: which recording, world, mechanism, attack and metric.

A number has one address from the plan of a run to its page. Columns of the files are a
projection of it. Their text is written and parsed here and in `evaluation.plan.world`,
nowhere else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Final, NamedTuple

from evaluation.plan.constants import SHARED, TRACK_RELEASES
from evaluation.plan.world import OWN_WORLD, World, parse_world

_CONTROL: Final = "control-"
_JOINT: Final = "rank1_assigned"  # Mates assigned one to one; people read "joint".
_ANSWERED_BY: Final = ",policy="  # Between a release of tracks and its policy.
_NOISE_BEFORE: Final = ",noise=before"  # After the tracker of such a release.
_UNDER: Final = " under "  # Between consumer and policy.
_LABEL: Final = re.compile(
    rf"(.+?)(?: \((\w+)\))?(, joint)?(?:{_UNDER}(\S+?))?(?:, (\S+))?"
)


class MechanismLevel(NamedTuple):
    """A mechanism at a level: what the numbers of a row of a table have in common."""

    mechanism: str  # SPEC without the level.
    level: float | None = None  # None: the mechanism has none.


class _CachedHash:
    """A slot for the cached hash of an address.

    It is a base class, so that dataclass fields, copies and pickles do not include it.
    The hash is cached at the first call, for the life of the address: a report asks
    half a million times.
    """

    __slots__ = ("_hash",)
    _hash: int


@dataclass(frozen=True, slots=True)
class Address(_CachedHash):
    """Where a number of a study belongs; a part that is not needed is left out.

    All numbers of a table or a mapping may share a part: then it is left out there.

    Examples
    --------
    Rank 1 of a linker with FID noise, from the columns `consumer` and `knowledge`:

    >>> linker = parse_consumer("rerelease/dtw@kalman_rts", "blind")
    >>> linker.task, linker.plugin, linker.reconstruction
    ('rerelease', 'dtw', 'kalman_rts')
    >>> number = linker.at("fid", 1.0, "rank1")
    >>> number.label, number.level, number.metric
    ('rerelease/dtw@kalman_rts (blind)', 1.0, 'rank1')
    """

    recording: str = ""  # Name of the data set.
    world: World = OWN_WORLD
    mechanism: str = ""  # SPEC without the level.
    level: float | None = None  # None: the mechanism has none.
    # Adding rule that the mechanism declares; it follows from the mechanism.
    adding: str = field(default="", compare=False)
    # Which queries are answered, and from which tracks, as `policy_text` writes it;
    # empty: all is disclosed.
    policy: str = ""
    task: str = ""  # Linkage task; empty: in scenes.
    # SPEC of the predictor, attack or linker; or `shared`, `bound`, `windows`, or a
    # control's name with `control-` in front.
    plugin: str = ""
    reconstruction: str = ""  # SPEC of that which a linker runs behind.
    adversary: str = ""  # In the column `knowledge`; empty: not an attack.
    metric: str = ""

    def __hash__(self) -> int:
        """Return a hash without recording, world and policy.

        A mapping has numbers of one of each, as a rule.
        """
        try:
            return self._hash
        except AttributeError:
            parts = (
                self.mechanism,
                self.level,
                self.task,
                self.plugin,
                self.reconstruction,
                self.adversary,
                self.metric,
            )
            object.__setattr__(self, "_hash", hash(parts))
            return self._hash

    @property
    def attack_spec(self) -> str:
        """The column `consumer` without the task: `dtw@kalman_rts`."""
        if not self.reconstruction:
            return self.plugin
        return f"{self.plugin}@{self.reconstruction}"

    @property
    def consumer(self) -> str:
        """The column `consumer`: `rerelease/dtw@kalman_rts`."""
        return f"{self.task}/{self.attack_spec}" if self.task else self.attack_spec

    @property
    def control(self) -> str:
        """Name of a control of a linkage task; empty: it is none."""
        is_control = bool(self.task) and self.plugin.startswith(_CONTROL)
        return self.plugin.removeprefix(_CONTROL) if is_control else ""

    @property
    def dataset(self) -> str:
        """The column `dataset`: the recording, and the world if not the run's own."""
        return f"{self.recording}:{self.world.text}" if self.world else self.recording

    @property
    def label(self) -> str:
        """Text for people: the consumer, the adversary, and whether mates are joint.

        The files of a run have the `cell_label`, with policy and world.
        """
        name = self.consumer
        if self.adversary:
            name = f"{name} ({self.adversary})"
        return f"{name}, joint" if self.metric == _JOINT else name

    @property
    def cell_label(self) -> str:
        """Name of the consumer in the files of a run: label, policy and world."""
        label = f"{self.label}{_UNDER}{self.policy}" if self.policy else self.label
        return f"{label}, {self.world.text}" if self.world else label

    @property
    def mechanism_level(self) -> MechanismLevel:
        """Mechanism and level."""
        return MechanismLevel(self.mechanism, self.level)

    @property
    def measure(self) -> Address:
        """The metric of a consumer, measured at every mechanism level."""
        return _measure(
            self.task, self.plugin, self.reconstruction, self.adversary, self.metric
        )

    @property
    def reader(self) -> Address:
        """The reader of a release alone: consumer and adversary, no level, no metric."""
        return _measure(self.task, self.plugin, self.reconstruction, self.adversary, "")

    @property
    def without_task(self) -> Address:
        """The same without its task."""
        return replace(self, task="")

    def at(
        self,
        mechanism: str,
        level: float | None,
        metric: str | None = None,
        *,
        adding: str = "",
    ) -> Address:
        """Return the same at a level of a mechanism, by its own metric or another.

        All other parts stay but the adding rule, which follows from the mechanism: it
        is `adding`.
        """
        # Not `replace`, here and below: it takes three times as long, and a report asks
        # for thousands.
        return Address(
            recording=self.recording,
            world=self.world,
            mechanism=mechanism,
            level=level,
            adding=adding,
            policy=self.policy,
            task=self.task,
            plugin=self.plugin,
            reconstruction=self.reconstruction,
            adversary=self.adversary,
            metric=self.metric if metric is None else metric,
        )

    def measured(self, metric: str) -> Address:
        """Return the same by another metric."""
        return Address(
            recording=self.recording,
            world=self.world,
            mechanism=self.mechanism,
            level=self.level,
            adding=self.adding,
            policy=self.policy,
            task=self.task,
            plugin=self.plugin,
            reconstruction=self.reconstruction,
            adversary=self.adversary,
            metric=metric,
        )

    def within(self, recording: str = "", world: World = OWN_WORLD) -> Address:
        """Return the same in a recording and world; by default without them."""
        return Address(
            recording=recording,
            world=world,
            mechanism=self.mechanism,
            level=self.level,
            adding=self.adding,
            policy=self.policy,
            task=self.task,
            plugin=self.plugin,
            reconstruction=self.reconstruction,
            adversary=self.adversary,
            metric=self.metric,
        )

    def to_columns(self) -> dict[str, Any]:
        """Return the columns of a file, without those of parts of the mechanism."""
        return {
            "dataset": self.dataset,
            "mechanism": self.mechanism,
            "level": math.nan if self.level is None else self.level,
            "consumer": self.consumer,
            "knowledge": self.adversary,
            "metric": self.metric,
            "adding": self.adding,
        }


# A run has a few hundred consumers, and some metrics of each; for the process.
@lru_cache(maxsize=2**14)
def _measure(
    task: str, plugin: str, reconstruction: str, adversary: str, metric: str
) -> Address:
    """Return the address of a consumer's metric, or of the consumer alone."""
    return Address(
        task=task,
        plugin=plugin,
        reconstruction=reconstruction,
        adversary=adversary,
        metric=metric,
    )


AS_SHARED: Final = Address(plugin=SHARED)


class PolicyParts(NamedTuple):
    """The parts of a text of the column `policy`; an empty part is left out of it."""

    track_release: str  # Of tracks, or detections: as `track_release_text` writes it.
    policy: str  # SPEC of the disclosure policy.


def track_release_text(
    release_kind: str, tracker: str, *, has_noise_before: bool
) -> str:
    """Return the text of a release of tracks: `RELEASE:TRACKER`, as `tracks:gnn`.

    `release_kind` is of `TRACK_RELEASES`, and `tracker` a SPEC. Noise may act before
    tracking.
    """
    text = f"{release_kind}:{tracker}"
    return f"{text}{_NOISE_BEFORE}" if has_noise_before else text


def policy_text(*, track_release: str, policy: str) -> str:
    """Return the text of the column `policy`.

    It is a disclosure policy, a release of tracks, or `RELEASE:TRACKER,policy=SPEC` of a
    policy that answers from tracks.
    """
    if track_release and policy:
        return f"{track_release}{_ANSWERED_BY}{policy}"
    return track_release or policy


def parse_policy(text: str) -> PolicyParts:
    """Return the parts of a text of the column `policy`."""
    if text.partition(":")[0] not in TRACK_RELEASES:
        return PolicyParts("", text)
    release, _, policy = text.partition(_ANSWERED_BY)
    return PolicyParts(release, policy)


def is_track_release(text: str) -> bool:
    """Whether a text of the column `policy` names a release of tracks, or detections."""
    return bool(parse_policy(text).track_release)


def control_name(name: str) -> str:
    """Return the plug-in of the address of a control."""
    return f"{_CONTROL}{name}"


def plugin_name(spec: str) -> str:
    """Return the name in a SPEC, without parameters: `fid` of `fid:adding=linear`."""
    return spec.partition(":")[0]


# A run has a few hundred consumers, and tens of thousands of rows; for the process.
@lru_cache(maxsize=4096)
def parse_consumer(consumer: str, adversary: str = "") -> Address:
    """Return the address of the columns `consumer` and `knowledge`."""
    task, separator, attack = consumer.partition("/")
    # A parameter may have a slash.
    if not separator or ":" in task:
        task, attack = "", consumer
    plugin, _, reconstruction = attack.partition("@")
    return Address(
        task=task, plugin=plugin, reconstruction=reconstruction, adversary=adversary
    )


@lru_cache(maxsize=256)  # The names of a run's data sets; for the process.
def parse_dataset(dataset: str) -> Address:
    """Return the address of the column `dataset`: recording and world."""
    recording, _, end = dataset.rpartition(":")
    world = parse_world(end) if recording else None
    if world is None:
        return Address(recording=dataset)
    return Address(recording=recording, world=world)


def parse_label(label: str) -> Address:
    """Return the address of a `cell_label`, or of a `label`."""
    match = _LABEL.fullmatch(label)
    world = match and parse_world(match[5] or "")
    if match is None or world is None:
        return parse_consumer(label)
    consumer, adversary, joint, policy, _ = match.groups()
    address = parse_consumer(consumer, adversary or "")
    metric = _JOINT if joint else ""
    return replace(address, world=world, policy=policy or "", metric=metric)


def parse_row(row: Mapping[Any, Any]) -> Address:
    """Return the address of a row of a file, or of an entry of a manifest.

    Columns that the row does not have are parts that the address leaves out. The world
    of an entry has a column of its own, that of a row stands in its data set.
    """
    level = row.get("level")
    dataset = parse_dataset(_text(row, "dataset"))
    reader = parse_consumer(_text(row, "consumer"), _text(row, "knowledge"))
    return Address(
        recording=dataset.recording,
        world=parse_world(_text(row, "world")) or dataset.world,
        mechanism=_text(row, "mechanism"),
        level=None if level is None or math.isnan(level) else float(level),
        adding=_text(row, "adding"),
        policy=_text(row, "policy"),
        task=reader.task,
        plugin=reader.plugin,
        reconstruction=reader.reconstruction,
        adversary=reader.adversary,
        metric=_text(row, "metric"),
    )


def _text(row: Mapping[Any, Any], column: str) -> str:
    """Return the text of a column; an empty text is NaN in a file that was read."""
    text = row.get(column)
    return text if isinstance(text, str) else ""
