"""Rotations of pseudonyms: when they are, and who is present before and after."""

from dataclasses import dataclass

import numpy as np

from attacks.tasks.task_input import CLOCK_S
from attacks.tasks.task_list import TASKS, Task
from isac_track.config import LinkageSettings
from isac_track.types import Bools, Floats


@dataclass(frozen=True, eq=False, slots=True)
class Rotations:
    """S rotations: at each all pseudonyms end, and new ones begin after a silence."""

    old_end_s: Floats  # (S,) last instant of the old pseudonyms.
    new_begin_s: Floats  # (S,) first instant of the new pseudonyms.
    least_s: float  # A person or track counts if present for so long on a side.

    def present_before(self, came_s: Floats, left_s: Floats) -> Bools:
        """Return who is present up to each rotation, (S, N).

        `came_s` and `left_s`, (N,), are first and last instants of people or tracks.
        """
        return present_throughout(
            came_s, left_s, self.old_end_s - self.least_s, self.old_end_s
        )

    def present_after(self, came_s: Floats, left_s: Floats) -> Bools:
        """Return who is present from the end of each silence on, (S, N)."""
        return present_throughout(
            came_s, left_s, self.new_begin_s, self.new_begin_s + self.least_s
        )


def present_throughout(
    came_s: Floats, left_s: Floats, first_s: Floats, last_s: Floats
) -> Bools:
    """Return which of N are there from each of S first to last instants, (S, N)."""
    came = came_s - CLOCK_S <= first_s[:, None]
    return np.asarray(came & (left_s + CLOCK_S >= last_s[:, None]))


def find_rotations(
    first_s: float, last_s: float, *, task: Task, settings: LinkageSettings
) -> Rotations:
    """Return all rotations of a recording from `first_s` to `last_s`, evenly spaced.

    The old pseudonyms end at the same instants whatever the silence, so that tasks can
    be compared.
    """
    lasting_s = last_s - first_s - longest_silence_s() - settings.handover_least_s
    count = int(lasting_s / settings.handover_period_s)
    every_s = settings.handover_period_s * max(1.0, count / settings.handover_instants)
    n_rotations = min(count, settings.handover_instants)
    old_end_s = np.asarray(first_s + every_s * np.arange(1.0, n_rotations + 1))
    return Rotations(old_end_s, old_end_s + task.silence_s, settings.handover_least_s)


def longest_silence_s() -> float:
    """Return the longest silence of all tasks."""
    return max(task.silence_s for task in TASKS.values())
