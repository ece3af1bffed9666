"""`--list`: a line for everything that can be named, with its meaning and its unit.

No plug-in is imported: that takes seconds, and the code of strangers may fail. Their
sources are read instead.
"""

import ast
import textwrap
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

from evaluation.plan.presets import PRESETS
from isac_track.config import StageSettings

if TYPE_CHECKING:
    from isac_track.plugins import Kind

WIDTH: Final = 100  # Columns.
_KINDS: Final[tuple["Kind", ...]] = (
    "mechanisms",
    "predictors",
    "attacks",
    "policies",
    "trackers",
)
_NO_LEVELS: Final = ("", "adding", "law", "select_on")
"""First parameters that are no level."""
_LEVEL_UNITS: Final = {
    "eta": "1/(m^2 s)",
    "d_sigma": "m",
    "distance": "m",
    "every": "samples",
    "seconds": "s",
    "metres": "m",
    "share": "0..1",
}
"""Units of levels whose names do not end in their unit."""
_UNITS: Final = {
    "_mps": "m/s",
    "_ghz": "GHz",
    "_mhz": "MHz",
    "_hz": "Hz",
    "_dbm": "dBm",
    "_db": "dB",
    "_m2": "m^2",
    "_m": "m",
    "_s": "s",
}
"""Units by the end of a name."""
_CLAUSES: Final = ("; ", ": ", ". ", " (")  # A text may be cut before any of these.
SETTINGS: Final = {
    "resample.rate_min_hz": "lowest sampling rate of a track",
    "resample.rate_max_hz": "highest sampling rate of a track",
    "resample.rate_hold_s": "time after which a track's rate is drawn anew",
    "resample.min_duration_s": "shortest track that is used",
    "resample.max_overshoot_m": "farthest that a spline may leave the straight line",
    "scenes.agents": "pedestrians in a scene",
    "scenes.history_ratio": "share of a track that is history",
    "scenes.robot_x_m": "centre of the square that robots start in",
    "scenes.robot_y_m": "centre of the square that robots start in",
    "scenes.robot_spread_m": "half the side of that square",
    "scenes.near_miss_max_m": "largest separation of a near miss",
    "scenes.ring_min_m": "least distance of other pedestrians from the robot",
    "scenes.ring_max_m": "largest distance of other pedestrians from the robot",
    "scenes.clearance_m": "distance that other pedestrians keep over the horizon",
    "scenes.max_redraws": "draws of a place before the last is accepted",
    "sensing.place": "where a recording stands: centred, or as in the file",
    "sensing.bs_x_m": "position of the base station",
    "sensing.bs_y_m": "position of the base station",
    "sensing.carrier_ghz": "carrier frequency",
    "sensing.bandwidth_mhz": "bandwidth used for sensing",
    "sensing.n_paths": "number of propagation paths",
    "sensing.delay_spread_s": "largest excess delay of a path",
    "sensing.power_dbm": "effective transmit power in the beam",
    "sensing.noise_dbm": "noise floor",
    "sensing.path_loss_exponent": "path-loss exponent, each way",
    "sensing.beam_fluctuation_db": "standard deviation of the beam's gain",
    "sensing.rcs_m2": "radar cross-section of a pedestrian",
    "sensing.resource_share": "share of the radio resources used for sensing",
    "sensing.large_scale_db": "standard deviation of the large-scale gain",
    "sensing.decorrelation_m": "walked distance over which that gain changes",
    "sensing.processing_gain_db": "integration gain of the receiver",
    "sensing.crb_gap_db": "raw error above the Cramer-Rao bound",
    "sensing.sigma_cap_m": "largest standard deviation of the raw error",
    "sensing.law": "raw error: radial, isotropic or fixed_direction",
    "sensing.measurement": "raw error: scalar, or an ellipse by range_bearing",
    "sensing.n_antennas": "antennas of the array that measures the bearing",
    "sensing.scaling": "what the ellipse keeps of scalar: trace or information",
    "conflict.robot_speed_mps": "speed of the robot",
    "conflict.horizon_steps": "steps of the paper's prediction horizon",
    "conflict.horizons_s": "further horizons, separated by commas, or none",
    "conflict.window": "samples whose mean interval is the prediction step",
    "conflict.safety_radius_m": "separation below which there is a conflict",
    "conflict.decision": "a robot decides by the `mean` path or by `probability`",
    "conflict.probability_threshold": "probability at which a conflict is declared",
    "privacy.epsilon_m": "error below which a shared position counts as known",
    "privacy.intervals": "durations by a segment's own or the trajectory's intervals",
    "attacks.repeats": "further releases of a walk, for the adversary `repeats`",
    "linkage.window_s": "length of a release in rerelease and new_traversal",
    "linkage.rerelease_shift_s": "largest shift between two releases of a walk",
    "linkage.split_window_s": "length of either window in split",
    "linkage.split_gap_s": "shortest gap between these windows",
    "linkage.handover_period_s": "time between two changes of all pseudonyms",
    "linkage.handover_window_s": "time seen on either side of a silence, at most",
    "linkage.handover_least_s": "time seen on either side of a silence, at least",
    "linkage.handover_instants": "changes of pseudonyms that are used, at most",
    "linkage.most_people": "people who are linked, at most",
    "linkage.candidates": "candidates scored for each probe; 0 scores all",
    "linkage.trait_strength": "spread of the simulated people's traits",
    "patrol.robots": "robots of a fleet, whose answers are one log",
    "patrol.fleets": "fleets with routes of their own; preset quick: 4",
    "patrol.query_s": "time between two queries of a robot",
    "patrol.scan_s": "interval of the clock of all people",
    "patrol.segment_s": "recording that is walked; quick: 200, else 300",
    "patrol.grid_s": "step of the instants that are judged",
    "patrol.errors": "errors last for a walk, or are fresh at every query",
    "patrol.pseudonyms": "pseudonyms last for a query, or for an encounter",
    "tracking.method": "SPEC of the tracker; `oracle` computes no tracks",
    "tracking.noise": "a mechanism acts after tracking, or before it on detections",
    "tracking.release": "a network releases tracks, or unlabelled detections",
    "tracking.detection_probability": "of a person at a scan, or `link`: link budget",
    "tracking.p_false_alarm": "probability of a false alarm of the detector, with `link`",
    "tracking.clutter_per_scan": "mean number of detections of nobody",
    "tracking.seeds": "draws of all sensing errors, which intervals draw",
    "tracking.block_s": "length of a block of the recording, which intervals draw",
}
"""The meaning of each stage setting; others are listed with name, value and unit."""


@dataclass(frozen=True, slots=True)
class ClassSummary:
    """The description and the first parameter of a class, read from its source."""

    about: str = ""  # First line of its docstring.
    parameter: str = ""  # Name of its first parameter.


def listing() -> list[str]:
    """Return everything that can be named, in lines by section, with its meaning."""
    from attacks.tasks.task_list import ALL_TASKS  # noqa: PLC0415 - needed for a list alone
    from isac_track.datasets.registry import KNOWN  # noqa: PLC0415 - as above

    sections: dict[str, dict[str, str]] = {
        "presets": {name: preset.summary for name, preset in PRESETS.items()},
        "data sets": {name: known.about for name, known in KNOWN.items()},
        **{kind: _plugins(kind) for kind in _KINDS},
        "tasks": {name: task.about for name, task in ALL_TASKS.items()},
        "settings (--set NAME=VALUE)": _settings(),
    }
    lines: list[str] = []
    for title, entries in sections.items():
        is_short = title not in ("presets", "data sets")
        width = max(map(len, entries), default=0)
        lines.append(f"{title}:")
        for name, text in entries.items():
            lines += _entry(f"  {name:<{width}}  ", text, is_short=is_short)
        lines.append("")
    return lines


def broken_plugins() -> list[str]:
    """Return a line for each discovered plug-in that cannot be used, with its fault."""
    from isac_track import plugins  # noqa: PLC0415 - names alone need none

    faults = chain.from_iterable(plugins.broken(kind).items() for kind in _KINDS)
    return [f"skipped {name}: {fault}" for name, fault in faults]


def read_class_summary(origin: str) -> ClassSummary:
    """Return the summary of `module:Class`; it is empty if the source is unreadable."""
    module, _, name = origin.partition(":")
    try:
        spec = find_spec(module)
        if spec is None or not spec.origin:
            return ClassSummary()
        tree = ast.parse(Path(spec.origin).read_bytes())
    except (ImportError, OSError, SyntaxError, ValueError):
        return ClassSummary()  # A run with this class reports the fault.
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            about = (ast.get_docstring(node) or "").partition("\n")[0].strip()
            return ClassSummary(about, _first_parameter(node))
    return ClassSummary()


def _first_parameter(node: ast.ClassDef) -> str:
    """Return the name of the first parameter of a class; empty without any."""
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            is_constant = "ClassVar" in ast.unparse(item.annotation)
            if not is_constant:
                return item.target.id
    return ""


def _plugins(kind: "Kind") -> dict[str, str]:
    """Return the descriptions of a kind's plug-ins by name.

    The name of a mechanism or policy includes its level and the unit of that.
    """
    from isac_track import plugins  # noqa: PLC0415 - needed for a list alone

    entries = {}
    for name, origin in plugins.names(kind).items():
        summary = read_class_summary(origin)
        shown = name
        level = summary.parameter
        if kind in ("mechanisms", "policies") and level not in _NO_LEVELS:
            unit = _LEVEL_UNITS.get(level) or _unit(level)
            shown = f"{name}:{level.upper()}"
            if unit:
                shown += f" ({unit})"
        entries[shown] = summary.about or origin
    return entries


def _settings() -> dict[str, str]:
    """Return every setting by name: its value with the unit, and its meaning."""
    values = {
        name: f"{value} {_unit(name)}".rstrip()
        for name, value in StageSettings().flat().items()
    }
    width = max(map(len, values.values()))
    return {
        name: f"{text:<{width}}  {SETTINGS.get(name, '')}".rstrip()
        for name, text in values.items()
    }


def _unit(name: str) -> str:
    """Return the unit at the end of a name; empty without any."""
    return next((unit for end, unit in _UNITS.items() if name.endswith(end)), "")


def _entry(start: str, text: str, *, is_short: bool) -> list[str]:
    """Return an entry in lines, or shortened to a single line."""
    room = WIDTH - len(start)
    if not is_short:
        first, *more = textwrap.wrap(text, room) or [""]
        return [f"{start}{first}", *(f"{'':{len(start)}}{line}" for line in more)]
    return [f"{start}{shorten_text(text, room=room)}"]


def shorten_text(text: str, *, room: int) -> str:
    """Return a text cut to `room` characters, at the end of a clause or a word."""
    if len(text) <= room:
        return text
    ends = [text.rfind(mark, 0, room) for mark in _CLAUSES]
    if max(ends) > room // 3:
        return text[: max(ends)]
    return textwrap.shorten(text, room, placeholder=" ...")
