"""Plain names of mechanisms, robots, attacks and tasks: one home for screen, page and figures.

Files, columns and options keep the SPEC (`fid:1,adding=independent`); a person reads these names.
"""

from typing import Final

from evaluation.analysis.families import Family
from evaluation.analysis.keys import level_text
from evaluation.reporting.rows import spoken

_MECHANISMS: Final = {
    "raw": "raw positions",
    "clean": "no error at all",
    "fid": "FID noise, eta {level}",
    "fixed": "fixed noise, {level} m",
    "ou": "slow noise, {level} m",
    "ou_fid": "slow FID noise, eta {level}",
    "laplace": "Laplace noise, {level} m",
    "forecast": "forecast noise, {level} m",
    "correlated": "correlated noise, {level} m",
    "offset": "constant shift, {level} m",
    "thin": "every {level}th sample",
    "window": "last {level} s only",
}
"""By family. A mechanism that is not here is a user's: it is called by its SPEC."""

_ROBOTS: Final = {
    "least_squares": "paper's line",
    "constant_position": "standing still",
    "kalman_cv": "Kalman",
    "kalman_cv:aware=true": "Kalman that knows the noise",
    "kalman_ca": "Kalman with acceleration",
    "kalman_imm": "Kalman of two motions",
}

_ATTACKS: Final = {
    "identity": "positions as sent",
    "moving_average": "moving average",
    "savgol": "Savitzky-Golay filter",
    "kalman_rts": "Kalman smoother",
    "radial_rts": "radial Kalman smoother",
    "ou_rts": "smoother of slow noise",
    "imm_rts": "smoother of two motions",
    "gaussian_process": "Gaussian process",
    "averaging": "averaging of releases",
    "corrector": "learnt corrector",
    "posterior": "posterior sampling",
}

_TASKS: Final = {
    "rerelease": "between two logs of the same steps",
    "rerelease-framed": "between two logs of the same steps with frame and clock",
    "split": "between two windows of a walk",
    "handover-1s": "after 1 s of silence",
    "handover-2s": "after 2 s of silence",
    "handover-5s": "after 5 s of silence",
    "new_traversal": "on another simulated day",
    "cross_session": "in another session",
}


def mechanism_name(family: Family, level: float | None) -> str:
    """Return what a level of a mechanism is called.

    Parameters that are not the default follow in brackets, the adding rule last if it is not the
    paper's: `FID noise, eta 1 (independent)`.
    """
    pattern = _MECHANISMS.get(family.family)
    if pattern is None:
        name = f"{spoken(family.family)}:{level_text(level)}".rstrip(":")
    else:
        name = pattern.format(level=level_text(level))
    details = [family.parameters] if family.parameters else []
    if "adding=independent" in family.mechanism:
        details.append("independent")
    return f"{name} ({', '.join(details)})" if details else name


def robot_name(consumer: str) -> str:
    """Return what a robot's predictor is called."""
    return _ROBOTS.get(consumer, spoken(consumer))


def attack_name(consumer: str) -> str:
    """Return what a reconstruction attack is called."""
    return _ATTACKS.get(consumer, spoken(consumer))


def task_phrase(task: str) -> str:
    """Return when or where a linkage task finds people again: `after 1 s of silence`."""
    return _TASKS.get(task, f"in {task}")
