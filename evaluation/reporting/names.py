"""Plain names of mechanisms, robots, attacks and tasks, for screen, page and figures.

Files, columns and options keep the SPEC (`fid:1,adding=independent`); a person reads
these names.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

from attacks.tasks.task_list import ALL_TASKS
from evaluation.estimates.families import Family
from evaluation.estimates.keys import level_text
from evaluation.estimates.metrics import METRICS
from evaluation.plan.address import plugin_name
from evaluation.reporting.table import plugin_label
from isac_track.plugins import built_in_mechanisms

_MECHANISMS: Final = {
    family: cls.plain_name for family, cls in built_in_mechanisms().items()
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

_ROBOT_SUBJECTS: Final = {
    "least_squares": "the paper's straight line",
    "constant_position": "a robot that expects people to stand still",
    "kalman_cv": "a Kalman robot",
    "kalman_cv:aware=true": "a Kalman robot that knows the noise",
    "kalman_ca": "a Kalman robot with acceleration",
    "kalman_imm": "a Kalman robot of two motions",
}

_ATTACKS: Final = {
    "identity": "positions as sent",
    "moving_average": "moving average",
    "savgol": "Savitzky-Golay filter",
    "kalman_rts": "Kalman smoother",
    "radial_rts": "radial Kalman smoother",
    "ou_rts": "smoother of slow noise",
    "gaussian_process": "Gaussian process",
    "averaging": "averaging of releases",
    "corrector": "learnt corrector",
}

_ADVERSARIES: Final = {
    "blind": "an adversary with the release alone",
    "informed": "an adversary that knows the mechanism",
    "repeats": "an adversary with several releases of each walk",
    "anchor": "an adversary with one true position",
    "companions": "an adversary with the companions' releases",
    "insider": "an adversary with frame and clock",
    "oracle": "an adversary that knows everything",
}
"""By the name that `--adversary` takes."""

_ADDING: Final = {
    "linear": "noise added as in the paper",
    "independent": "noise independent of the sensing error",
}

_DESCRIPTORS: Final = {
    "plr": "privacy leakage ratio",
    "ael": "average exposure length",
    "mel": "mean maximum exposure length",
}

_SHORTCUTS: Final = {"duration": "track length", "noise_level": "noise level"}

_ISOTROPIC: Final = "law=isotropic"
INDEPENDENT_MARK: Final = " *"
"""Marks a level whose noise is independent of the sensing error, if room is short."""
INDEPENDENT_NOTE: Final = "* Noise is independent of the sensing error."


_WITHOUT_LEVEL: Final = {"thin": "thinned samples", "window": "last seconds only"}
"""Names of families where the level stands within."""

# By name in a file: the name that people read; of a mechanism without its level.
ATTACK_NAMES: Final[Mapping[str, str]] = MappingProxyType(_ATTACKS)
ROBOT_NAMES: Final[Mapping[str, str]] = MappingProxyType(_ROBOTS)
FAMILY_NAMES: Final[Mapping[str, str]] = MappingProxyType(
    {
        family: _WITHOUT_LEVEL.get(family, pattern.partition(",")[0])
        for family, pattern in _MECHANISMS.items()
    }
)


def family_name(family: Family) -> str:
    """Return the name of a mechanism without its level: `FID noise (independent)`."""
    details = _other_parameters(family)
    if is_independent(family):
        details.append("independent")
    return _detailed_name(family, details)


def short_family_name(family: Family) -> str:
    """Return a short name of a mechanism; a mark says that noise is independent."""
    name = _detailed_name(family, _other_parameters(family))
    return f"{name}{INDEPENDENT_MARK}" if is_independent(family) else name


def _detailed_name(family: Family, details: Sequence[str]) -> str:
    """Return the name of a mechanism with some details in brackets."""
    name = FAMILY_NAMES.get(family.family, plugin_label(family.family))
    if _ISOTROPIC in family.parameters:
        name = f"isotropic {name}"
    return f"{name} ({', '.join(details)})" if details else name


def spec_text(family: Family, level: float | None) -> str:
    """Return a level as options take it: `fid:1,adding=independent`."""
    name = plugin_name(family.mechanism)
    parameters = family.mechanism.removeprefix(name).removeprefix(":")
    if "." in name:  # A class in a module has a colon of its own.
        return " ".join(filter(None, [family.mechanism, level_text(level)]))
    values = ",".join(filter(None, [level_text(level), parameters]))
    return f"{name}:{values}" if values else name


def mechanism_name(family: Family, level: float | None) -> str:
    """Return the name of a level of a mechanism.

    Parameters that are not the default follow in brackets, the adding rule last if it
    is not the paper's: `FID noise, eta 1 (independent)`.
    """
    return _with_details(_plain_name(family, level), _details(family))


def short_mechanism_name(family: Family, level: float | None) -> str:
    """Return a short name of a level; a mark says that noise is independent."""
    name = _with_details(_plain_name(family, level), _other_parameters(family))
    return f"{name}{INDEPENDENT_MARK}" if is_independent(family) else name


def mechanism_phrase(family: Family, level: float | None) -> str:
    """Return a level in the middle of a sentence: `slow noise of 0.4 m`."""
    name = _plain_name(family, level)
    if family.family in _MECHANISMS:
        name = name.replace(", eta", " at eta").replace(", ", " of ")
    return _with_details(name, _details(family))


def is_independent(family: Family) -> bool:
    """Return whether a parameter makes the noise independent of the sensing error."""
    return "adding=independent" in family.mechanism


def _details(family: Family) -> list[str]:
    """Return the details in brackets behind a name."""
    rule = ["independent"] if is_independent(family) else []
    return [*_other_parameters(family), *rule]


def _with_details(name: str, details: Sequence[str]) -> str:
    return f"{name} ({', '.join(details)})" if details else name


def _plain_name(family: Family, level: float | None) -> str:
    """Return the name of a level without its parameters, but for an isotropic law."""
    pattern = _MECHANISMS.get(family.family)
    if pattern is None:
        return f"{plugin_label(family.family)}:{level_text(level)}".rstrip(":")
    name = pattern.format(level=level_text(level))
    return f"isotropic {name}" if _ISOTROPIC in family.parameters else name


def _other_parameters(family: Family) -> list[str]:
    """Return the parameters beside the level, the adding rule and an isotropic law."""
    given = [text for text in family.parameters.split(",") if text]
    if family.family not in _MECHANISMS:
        return given
    return [text for text in given if text != _ISOTROPIC]


def robot_name(consumer: str) -> str:
    """Return the name of a robot's predictor."""
    return _ROBOTS.get(consumer, plugin_label(consumer))


def is_built_in_robot(consumer: str) -> bool:
    """Return whether a predictor is the project's own, not a user's."""
    return consumer in _ROBOTS


def robot_subject(consumer: str) -> str:
    """Return a robot as the subject of a sentence: `a Kalman robot`."""
    return _ROBOT_SUBJECTS.get(consumer, f"a robot with {robot_name(consumer)}")


def attack_name(consumer: str) -> str:
    """Return the name of a reconstruction attack."""
    return _ATTACKS.get(consumer, plugin_label(consumer))


def task_phrase(task: str) -> str:
    """Return time or place of a linkage task's second log: `after 1 s of silence`."""
    return ALL_TASKS[task].phrase if task in ALL_TASKS else f"in {task}"


def task_head(task: str) -> str:
    """Return the heading of a column of re-identified people."""
    return ALL_TASKS[task].head if task in ALL_TASKS else task


def adversary_name(adversary: str) -> str:
    """Return an adversary as the subject of a sentence."""
    return _ADVERSARIES.get(adversary, f"the adversary {adversary}")


def adding_phrase(adding: str) -> str:
    """Return an adding rule after the word `with`."""
    return _ADDING.get(adding, f"{adding} noise")


def descriptor_name(metric: str) -> str:
    """Return the name of a privacy descriptor, that of the paper's spelled out."""
    return _DESCRIPTORS.get(metric) or METRICS[metric].text


def shortcut_name(shortcut: str) -> str:
    """Return the property by which a control of linkage tells people apart."""
    return _SHORTCUTS.get(shortcut, shortcut.replace("_", " "))


def dataset_title(name: str) -> str:
    """Return a data set as the start of a sentence; a path stays as it is."""
    return name if "/" in name or "." in name else name[:1].upper() + name[1:]
