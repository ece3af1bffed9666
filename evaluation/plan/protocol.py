"""The protocol of the board: recordings, settings, readers and scores of every card.

`evaluation/protocol.toml` has the values; docs/protocol.md explains them.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from isac_track.config import StageSettings
from isac_track.errors import SettingsError, did_you_mean


@dataclass(frozen=True, slots=True)
class Protocol:
    """What all cards of a version have in common."""

    version: int
    digest: str  # sha256 of all values, whatever the layout of their file.
    laws: tuple[str, ...]  # Of the sensing error.
    seeds: tuple[int, ...]  # Those that are published.
    mechanisms: tuple[str, ...]  # SPECs that a board should hold.
    policies: tuple[str, ...]
    robots: tuple[str, ...]
    log: tuple[str, ...]  # Estimators of positions from a log with true identities.
    chains: tuple[str, ...]  # Adversaries that join the answers themselves.
    attacks: tuple[str, ...]  # SPECs of attacks on a log with true identities.
    horizon_s: float
    primary: Mapping[str, str]  # Metric of each axis of the board.
    agreement: Mapping[str, float]
    recordings: Mapping[str, str]  # sha256 by name.
    settings: Mapping[str, Any]

    def stages(self, law: str) -> StageSettings:
        """Return the stage settings under a law; SettingsError for an unknown law."""
        if law not in self.laws:
            hint = did_you_mean(law, self.laws)
            raise SettingsError(
                f"--law {law!r} is not in protocol {self.version}"
                f" ({', '.join(self.laws)}){hint}"
            )
        return StageSettings().changed(
            {
                **self.settings,
                "sensing.law": law,
                "conflict.horizons_s": (self.horizon_s,),
            }
        )

    def recording_digest(self, name: str) -> str:
        """Return the sha256 of a recording; SettingsError if the protocol has none."""
        if name not in self.recordings:
            hint = did_you_mean(name, self.recordings)
            raise SettingsError(
                f"{name!r} is no recording of protocol {self.version}{hint}"
                f" (it has {', '.join(self.recordings)})"
            )
        return self.recordings[name]


# The file does not change while a process runs.
@cache
def read_protocol() -> Protocol:
    """Return the protocol of this version of the project."""
    text = files("evaluation").joinpath("protocol.toml").read_text(encoding="utf-8")
    content = tomllib.loads(text)
    lists = (
        "laws",
        "seeds",
        "mechanisms",
        "policies",
        "robots",
        "log",
        "chains",
        "attacks",
    )
    fixed = {name: tuple(content[name]) for name in lists}
    return Protocol(**{**content, **fixed}, digest=protocol_digest(content))


def protocol_digest(content: Mapping[str, Any]) -> str:
    """Return the sha256 of a protocol's values, in whichever order and layout."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
