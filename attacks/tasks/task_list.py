"""Which linkage tasks there are, and what each tells an adversary about frame and clock.

Every task shows walks twice, before and after the pseudonyms change: as probe and as
gallery. In a handover those of the live recording rotate at one instant, in the true
frame and on the true clock: who left has no mate, who is new is a candidate all the
same. In the others everybody is in both; they hide frame and clock, but for
`rerelease-framed`, which no task is easier than.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from isac_track.errors import SettingsError, did_you_mean
from isac_track.protocols import OF_WALKS
from isac_track.types import Knowledge


@dataclass(frozen=True, slots=True)
class Task:
    """What is linked, and what the adversary is told about frame and clock."""

    name: str
    about: str
    # Whether the releases come in the true frame and on the true clock.
    shows_scene: bool = False
    gap_s: float = 0.0  # Silence before all pseudonyms rotate.
    # Of people in two sessions: so few that one is left out to learn.
    comes_back: bool = False
    is_one_stretch: bool = False  # Whether both show the same steps, in part at least.
    # Whether it needs the two-session crowd instead of a recording.
    simulated: bool = False

    @property
    def family(self) -> str:
        """Name without the gap, and of what makes its sessions, in `attacks.tasks.build`.

        Tasks that differ in the gap alone share their draws.
        """
        return self.name.partition("-")[0]

    @property
    def is_open(self) -> bool:
        """Whether some probes have no mate: who left meanwhile, before all pseudonyms rotated."""
        return self.gap_s > 0.0

    @property
    def is_one_walk(self) -> bool:
        """Whether probe and gallery show one walk of one session."""
        return not (self.simulated or self.comes_back)

    @property
    def is_one_time(self) -> bool:
        """Whether that walk is sensed once, both sides at their own times of it."""
        return self.is_one_walk and not self.is_one_stretch

    @property
    def everyone(self) -> frozenset[Knowledge]:
        """What every adversary is granted."""
        return frozenset({Knowledge.SCENE} if self.shows_scene else ())

    @property
    def nobody(self) -> frozenset[Knowledge]:
        """What no adversary is granted: it would turn the task into another one."""
        return (OF_WALKS | {Knowledge.SCENE}) - self.everyone


TASKS: Final[Mapping[str, Task]] = {
    task.name: task
    for task in (
        Task(
            "rerelease",
            "two logs of the same steps, without frame or clock",
            is_one_stretch=True,
        ),
        Task(
            "rerelease-framed",
            "two logs of the same steps, in the true frame and on the true clock: the"
            " bound",
            shows_scene=True,
            is_one_stretch=True,
        ),
        Task(
            "split",
            "two windows of one walk that do not touch: behaviour, and its noise level",
        ),
        *(
            Task(
                f"handover-{gap_s:g}s",
                f"all pseudonyms rotate after {gap_s:g} s of silence, in the true"
                " frame",
                shows_scene=True,
                gap_s=gap_s,
            )
            for gap_s in (1.0, 2.0, 5.0)
        ),
        Task(
            "new_traversal", "the same person on another day, simulated", simulated=True
        ),
        Task(
            "cross_session", "the same real person in another session", comes_back=True
        ),
    )
}


def task_named(name: str) -> Task:
    """Return the task of a name; SettingsError, with what may have been meant, if there is none."""
    if name not in TASKS:
        hint = did_you_mean(name, TASKS, quote="'") or f"; known: {', '.join(TASKS)}"
        raise SettingsError(f"unknown task {name!r}{hint}")
    return TASKS[name]
