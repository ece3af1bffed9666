"""The axes of a run: presets, settings, and the levels and consumers that they expand to."""

from __future__ import annotations

from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import TYPE_CHECKING, Literal

from isac_track import registry
from isac_track.config import StageSettings
from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from pathlib import Path

    from isac_track.registry import Plugin
    from isac_track.types import Knowledge

SHARED = "shared"
"""Consumer of the descriptors as shared."""
BLOCK_SCENES = 250
"""Scenes of a cell. Part of the keys of the sharing streams: a change changes the draws."""


MOST_SCENES = 10_000_000


@dataclass(frozen=True, slots=True)
class Preset:
    """Axes that a name stands for."""

    scenes: int
    mechanisms: tuple[str, ...]
    predictors: tuple[str, ...]
    attacks: tuple[str, ...]
    summary: str


_SWEEP = (
    "raw",
    *(
        f"{axis}{rule}"
        for rule in ("", ",adding=independent")
        for axis in ("fid:1..1000/10", "fid:1e4", "fid:1e5", "fid:1e6", "fixed:0.1..1/10")
    ),
)
_PREDICTORS = ("least_squares", "kalman_cv", "kalman_ca", "kalman_imm")
# All built-in ones but the slow: imm_rts and gaussian_process run when named.
_ATTACKS = ("identity", "moving_average", "savgol", "kalman_rts", "radial_rts", "averaging")
PRESETS = {
    "smoke": Preset(
        scenes=40,
        mechanisms=("raw", "fid:1", "fid:1000", "fixed:0.7", "fixed:1"),
        predictors=_PREDICTORS,
        attacks=_ATTACKS,
        summary="40 scenes, the 5 levels that the paper gives numbers for",
    ),
    "paper": Preset(
        scenes=500,
        mechanisms=_SWEEP,
        predictors=_PREDICTORS,
        attacks=_ATTACKS,
        summary="500 scenes, raw, 13 eta, 10 fixed errors, both adding rules",
    ),
    "full": Preset(
        scenes=5000,
        mechanisms=_SWEEP,
        predictors=_PREDICTORS,
        attacks=_ATTACKS,
        summary="the axes of paper on 5,000 scenes",
    ),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """A whole run. None means: as the preset, the lookup or the default folder says."""

    preset: str = "paper"
    dataset: str | None = None
    """Name of a known data set, or a path."""
    format: str | None = None
    fps: float | None = None
    scenes: int | None = None
    seed: int = 0
    mechanisms: tuple[str, ...] | None = None
    """SPECs; they replace the preset's."""
    predictors: tuple[str, ...] | None = None
    """SPECs; they replace the preset's. Empty: no predictor."""
    attacks: tuple[str, ...] | None = None
    """SPECs; they replace the preset's. Empty: no attack."""
    stages: StageSettings = field(default_factory=StageSettings)
    jobs: int | None = None
    """Worker processes; None: as many as there are cores where the work is worth it."""
    out: Path | str | None = None
    fresh: bool = False

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            near = get_close_matches(self.preset, PRESETS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(PRESETS)}"
            raise SettingsError(f"unknown preset {self.preset!r}; {hint}")
        if self.scenes is not None and not 2 <= self.scenes <= MOST_SCENES:  # noqa: PLR2004
            raise SettingsError(
                f"a run needs at least 2 scenes (one of each label) and at most {MOST_SCENES:,}, "
                f"got {self.scenes}"
            )
        if self.seed < 0:
            raise SettingsError(f"the seed must not be negative, got {self.seed}")
        if self.jobs is not None and self.jobs < 1:
            raise SettingsError(f"jobs must be at least 1, got {self.jobs}")
        if self.fps is not None and not self.fps > 0:
            raise SettingsError(f"fps must be positive, got {self.fps:g}")

    @property
    def n_scenes(self) -> int:
        """Scenes of the run."""
        return PRESETS[self.preset].scenes if self.scenes is None else self.scenes


@dataclass(frozen=True, slots=True)
class Consumer:
    """Who reads a release: a predictor, an adversary, or nobody (the descriptors as shared)."""

    kind: Literal["shared", "predictor", "attack"]
    plugin: Plugin | None = None
    knowledge: str = ""
    """Adversary that the row is named after: blind, informed or oracle."""
    granted: frozenset[Knowledge] = frozenset()

    @property
    def spec(self) -> str:
        """As in the column `consumer`."""
        return SHARED if self.plugin is None else self.plugin.spec

    @property
    def is_slow(self) -> bool:
        """Whether it runs on the first release of each source track only."""
        return self.plugin is not None and bool(getattr(self.plugin.instance, "slow", False))

    @property
    def is_built_in(self) -> bool:
        """Whether an attack is one of the project's own."""
        return self.plugin is not None and self.plugin.origin.startswith("attacks.")

    @property
    def label(self) -> str:
        """For people: with the adversary."""
        return f"{self.spec} ({self.knowledge})" if self.knowledge else self.spec


@dataclass(frozen=True, slots=True)
class Axes:
    """What the run crosses: every mechanism level with every consumer."""

    mechanisms: tuple[Plugin, ...]
    predictors: tuple[Plugin, ...]
    attacks: tuple[Plugin, ...]

    @property
    def consumers(self) -> tuple[Consumer, ...]:
        """All consumers of a level: the descriptors first, an attack once for each adversary."""
        from isac_track.protocols import grants  # noqa: PLC0415 - --help needs no numpy

        return (
            Consumer("shared"),
            *(Consumer("predictor", plugin) for plugin in self.predictors),
            *(
                Consumer("attack", plugin, knowledge=adversary, granted=granted)
                for plugin in self.attacks
                for adversary, granted in grants(plugin.instance).items()
            ),
        )


def axes(settings: Settings) -> Axes:
    """Return the plug-ins of a run, each once.

    Raises
    ------
    SettingsError
        If a SPEC is wrong or no mechanism is left.
    PluginError
        If a named plug-in cannot be loaded.
    """
    preset = PRESETS[settings.preset]
    mechanisms = preset.mechanisms if settings.mechanisms is None else settings.mechanisms
    predictors = preset.predictors if settings.predictors is None else settings.predictors
    attacks = preset.attacks if settings.attacks is None else settings.attacks
    expanded = Axes(
        mechanisms=registry.parse_all("mechanisms", mechanisms),
        predictors=registry.parse_all("predictors", predictors),
        attacks=registry.parse_all("attacks", attacks),
    )
    if not expanded.mechanisms:
        raise SettingsError("nothing to run: the mechanism axis is empty; name one, such as raw")
    return expanded


def n_blocks(n_scenes: int) -> int:
    """Return how many blocks of scenes a run has."""
    return -(-n_scenes // BLOCK_SCENES)
