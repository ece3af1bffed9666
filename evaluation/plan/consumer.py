"""Consumers: the readers of releases, whose numbers a run has at every level."""

from dataclasses import dataclass
from typing import Final, Literal

from evaluation.plan.address import Address, control_name, policy_text
from evaluation.plan.constants import BOUND, SHARED, WINDOWS
from evaluation.plan.world import OWN_WORLD, World
from isac_track import plugins
from isac_track.plugins import Plugin
from isac_track.types import Knowledge

FUSION: Final = "fusion"  # Of all linkers of people who come back.
LOG: Final = "log"  # Consumer of the answers that a fleet of robots was given.
TRACKER: Final = "tracker"  # Consumer of tracks: how well they are associated.
ORACLE_TRACKER: Final = "oracle"
"""Tracker that knows who is behind each detection."""
PATROL_KINDS: Final = ("patrol", "log")
"""Kinds of consumer that read answers of a policy."""
TRACK_KINDS: Final = ("tracks", "tracked", "track_log", "track_link")
"""Kinds of consumer that read tracks, or what a policy answers from them."""
_PLUGINLESS_CONSUMERS: Final = {
    "shared": SHARED,
    "windows": WINDOWS,
    "bound": BOUND,
    "link_bound": BOUND,
    "log": LOG,
    "track_log": LOG,
    "returns": FUSION,
    "tracks": TRACKER,
}
"""Names of consumers without a plug-in, by kind."""


@dataclass(frozen=True, slots=True)
class Consumer:
    """A reader of a release: a predictor, an adversary, or the plain descriptors."""

    kind: Literal[
        "shared",  # The descriptors of the scenes as shared.
        "predictor",  # A robot that meets people in scenes.
        "attack",  # An adversary that reconstructs the attacked scenes.
        "bound",  # The optimum that no reconstruction of these scenes exceeds.
        "linkage",  # A linker of a linkage task.
        "link_bound",  # The optimum of a linkage task in a model world.
        "control",  # A control of a linkage task: a linker that must not succeed.
        "windows",  # The descriptors of a linkage task's windows.
        "patrol",  # A robot on patrol that reads a policy's answers.
        "log",  # An adversary with the log of a fleet's answers.
        "returns",  # All linkers and controls of people who come back.
        "tracks",  # The metrics of a tracker's tracks.
        "tracked",  # A robot on patrol that reads tracks, or answers from them.
        "track_log",  # An adversary with the log of a policy's answers from tracks.
        "track_link",  # A linker of tracks across new pseudonyms, or a control.
    ]
    plugin: Plugin | None = None
    """Predictor, attack or linker; None for kinds without a plug-in."""
    adversary: str = ""
    """Name of its adversary, as in the column `knowledge`; empty for a robot."""
    granted: frozenset[Knowledge] = frozenset()
    """What its adversary knows beside the release."""
    task: str = ""
    """Task of a linkage attack, of a control, or of the descriptors of windows."""
    reconstruction: Plugin | None = None
    """Attack whose positions a linkage attack reads."""
    control: str = ""
    """Name of a control."""
    world: World = OWN_WORLD
    track_release: Plugin | None = None
    """Tracker of the tracks that it reads; its SPEC is that of their release."""
    policy: Plugin | None = None
    """Policy that answers a robot on patrol or a log; with tracks, None: all tracks."""

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """Its plug-in, the reconstruction in front of that, its tracker and policy."""
        own = (*self._reading_plugins, self.track_release, self.policy)
        return tuple(plugin for plugin in own if plugin is not None)

    @property
    def _reading_plugins(self) -> tuple[Plugin, ...]:
        """Its plug-ins that read a release."""
        own = (self.plugin, self.reconstruction)
        return tuple(plugin for plugin in own if plugin is not None)

    @property
    def spec(self) -> str:
        """As in the column `consumer`."""
        return self.address.consumer

    @property
    def address(self) -> Address:
        """Where its numbers belong, at every level."""
        reconstruction = None
        if self.control:
            name = control_name(self.control)
        elif self.plugin is not None:
            name, reconstruction = self.plugin.spec, self.reconstruction
        else:
            name = _PLUGINLESS_CONSUMERS[self.kind]
        return Address(
            world=self.world,
            policy=policy_text(
                track_release=self.track_release.spec if self.track_release else "",
                policy=self.policy.spec if self.policy else "",
            ),
            task=self.task,
            plugin=name,
            reconstruction=reconstruction.spec if reconstruction else "",
            adversary=self.adversary,
        )

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that any of its plug-ins cannot run without."""
        needs = (plugin.instance.requires for plugin in self._reading_plugins)
        return frozenset().union(*needs)

    @property
    def uses(self) -> frozenset[Knowledge]:
        """Knowledge that any of its plug-ins takes if granted."""
        uses = [plugin.instance.uses for plugin in self._reading_plugins]
        return frozenset().union(*uses)

    @property
    def reads_patrols(self) -> bool:
        """Whether it reads patrols: answers of a policy, or tracks of detections."""
        return self.track_release is not None or self.policy is not None

    @property
    def reads_tracks(self) -> bool:
        """Whether it reads tracks of detections."""
        return self.kind in TRACK_KINDS

    @property
    def is_slow(self) -> bool:
        """Whether it runs on the first release of each source track only."""
        return self.plugin is not None and bool(
            getattr(self.plugin.instance, "slow", False)
        )

    @property
    def is_built_in(self) -> bool:
        """Whether an attack is one of the project's own."""
        return self.plugin is not None and self.plugin.origin.startswith("attacks.")

    @property
    def kind_in_files(self) -> str:
        """As in a manifest, where the optimum of a linkage task is a linkage cell."""
        return "linkage" if self.kind == "link_bound" else self.kind

    @property
    def label(self) -> str:
        """Name for people: with the adversary, and the world if it is not the run's."""
        return self.address.cell_label


def windows_consumer(task: str) -> Consumer:
    """Return the consumer of a task's windows: their descriptors, smoothed or not."""
    # The built-in smoother, with no knowledge: the same whatever else is in the run.
    return Consumer(
        "windows", task=task, reconstruction=plugins.parse("attacks", "radial_rts")[0]
    )
