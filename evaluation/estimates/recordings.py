"""Recordings of numbers: a run's own, or that of a simulated task."""

from attacks.tasks.task_list import TASKS
from evaluation.plan.address import Address
from evaluation.plan.world import OWN_WORLD, World

# Data set of the simulated two-session crowd's tasks.
TWO_SESSIONS = "plaza-two-sessions"


def task_recording(task: str, *, dataset: str) -> str:
    """Return the recording of a task's people: a simulated task has its own."""
    known = TASKS.get(task)
    return TWO_SESSIONS if known is not None and known.simulated else dataset


def in_run(address: Address, *, dataset: str, world: World = OWN_WORLD) -> Address:
    """Return an address with its recording, in a run of `dataset`, and its world."""
    return address.within(task_recording(address.task, dataset=dataset), world)
