"""The linkage tasks, and the knowledge of frame and clock that each grants.

Every task shows walks twice, before and after the pseudonyms change: as probe and as
gallery. In a handover, all pseudonyms of the live recording rotate at one instant, in
the true frame and on the true clock. A person who left has no mate; a person who came
is a candidate all the same. In the other tasks everybody is on both sides. They hide
frame and clock, except `rerelease-framed`, the easiest task of all. `returns` alone
links whole passages of people who come back, several of each person.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from isac_track.errors import SettingsError, did_you_mean
from isac_track.protocols import WALK_KNOWLEDGE
from isac_track.types import Knowledge


@dataclass(frozen=True, slots=True)
class Task:
    """What a linkage task shows of walks, frame and clock."""

    name: str
    about: str  # What the releases are, in lists and in `linkability.csv`.
    sentence: str  # What the adversary does, in the glossary.
    phrase: str  # Time or place of the second log, after "re-identified".
    head: str  # Heading of a column of re-identified people.
    # Whether the releases come in the true frame and on the true clock.
    shows_scene: bool = False
    silence_s: float = 0.0  # From the old pseudonyms to the new: without samples.
    # Whether it is of the few people in two sessions: to train, a person is left out.
    links_returning_people: bool = False
    # Whether both sides show the same steps, at least in part.
    shows_same_steps: bool = False
    # Whether it needs the two-session crowd instead of a recording.
    simulated: bool = False

    @property
    def family(self) -> str:
        """Name without the silence. `attacks.tasks.build` has a maker for each family.

        Tasks that differ in the silence alone share their draws.
        """
        return self.name.partition("-")[0]

    @property
    def is_open(self) -> bool:
        """Whether some probes have no mate, since people left during the silence."""
        return self.silence_s > 0.0

    @property
    def is_single_walk(self) -> bool:
        """Whether probe and gallery show one walk of one session."""
        return not (self.simulated or self.links_returning_people)

    @property
    def is_sensed_once(self) -> bool:
        """Whether that walk is sensed once, each side at times of its own."""
        return self.is_single_walk and not self.shows_same_steps

    @property
    def granted_to_all(self) -> frozenset[Knowledge]:
        """Knowledge that every adversary is granted."""
        return frozenset({Knowledge.SCENE} if self.shows_scene else ())

    @property
    def granted_to_none(self) -> frozenset[Knowledge]:
        """Knowledge that no adversary is granted: it would make another task of it."""
        return (WALK_KNOWLEDGE | {Knowledge.SCENE}) - self.granted_to_all


TASKS: Final[Mapping[str, Task]] = {
    task.name: task
    for task in (
        Task(
            "rerelease",
            "two logs of the same steps, without frame or clock",
            sentence="Link two logs of the same steps, without true frame or clock.",
            phrase="between two logs of the same steps",
            head="two logs",
            shows_same_steps=True,
        ),
        Task(
            "rerelease-framed",
            "two logs of the same steps, in the true frame and on the true clock: the"
            " bound",
            sentence="Link two logs of the same steps, with true frame and clock.",
            phrase="between two logs of the same steps with frame and clock",
            head="framed logs",
            shows_scene=True,
            shows_same_steps=True,
        ),
        Task(
            "split",
            "two windows of one walk that do not touch: behaviour, and its noise level",
            sentence="Link two windows of one walk that do not overlap.",
            phrase="between two windows of a walk",
            head="two parts",
        ),
        *(
            Task(
                f"handover-{silence_s:g}s",
                f"all pseudonyms rotate after {silence_s:g} s of silence, in the true"
                " frame",
                sentence=f"Link people across {silence_s:g} s of silence.",
                phrase=f"after {silence_s:g} s of silence",
                head=f"after {silence_s:g} s",
                shows_scene=True,
                silence_s=silence_s,
            )
            for silence_s in (1.0, 2.0, 5.0)
        ),
        Task(
            "new_traversal",
            "the same person on another day, simulated",
            sentence="Link simulated people across two days.",
            phrase="on another simulated day",
            head="other day",
            simulated=True,
        ),
        Task(
            "cross_session",
            "the same real person in another session",
            sentence="Link real people across two recording sessions.",
            phrase="in another session",
            head="session 2",
            links_returning_people=True,
        ),
    )
}
"""The tasks that link windows of walks: `attacks.tasks.build`."""

NAMED_SESSIONS: Final = (
    "sessions that name people (a column person, comments such as '# 14 M 17', or a"
    " markerID), or --persistent-ids if equal ids are the same person"
)
"""What a recording lacks in which nobody is known to come back."""
RETURNS: Final = Task(
    "returns",
    "whole passages of the same real person in another run",
    sentence="Link whole passages of real people who walk in several runs.",
    phrase="in another run",
    head="other run",
    links_returning_people=True,
)
"""The task that links whole passages: `attacks.tasks.return_study`."""
FUSED: Final = ("gait", "behaviour", "likelihood_ratio")
"""Names of the linkers of `returns`; a run cannot choose others there."""
ALL_TASKS: Final[Mapping[str, Task]] = {**TASKS, RETURNS.name: RETURNS}


def task_named(name: str) -> Task:
    """Return the task of a name; SettingsError, with a suggestion, if there is none."""
    if name not in ALL_TASKS:
        known = f"; known: {', '.join(ALL_TASKS)}"
        hint = did_you_mean(name, ALL_TASKS, quote="'") or known
        raise SettingsError(f"unknown task {name!r}{hint}")
    return ALL_TASKS[name]
