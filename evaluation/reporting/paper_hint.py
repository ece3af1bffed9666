"""What a run of preset `quick` leaves to preset `paper`, and how long that would take."""

import shlex
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from evaluation.experiment.presets import DEFAULT
from evaluation.reporting.announcements import command

PAPER: Final = "paper"
_TIMES: Final = 4.0
"""Cost of `paper` over that of `quick`, roughly: never measured side by side on an idle machine."""
_WITH_VALUE: Final = ("--preset", "--out")
_FLAGS: Final = ("--fresh",)
_USUAL_SEED: Final = " --seed 0"


class PaperHint(NamedTuple):
    """The command of the same run with preset `paper`, and its estimated time."""

    command: str
    seconds: float


def paper_hint(manifest: Mapping[str, Any]) -> PaperHint | None:
    """Return how to run preset `paper` on the same data; None for a run of another preset.

    The time is estimated from that of the finished run, on the same machine.
    """
    if manifest["settings"]["preset"] != DEFAULT:
        return None
    again = command(manifest).removesuffix(_USUAL_SEED)
    words = iter(shlex.split(again))
    options = []
    for word in words:
        option, equals, _ = word.partition("=")
        if option in _WITH_VALUE:
            if not equals:
                next(words, None)
        elif option not in _FLAGS:
            options.append(word)
    run_s = float(manifest["wall_time_s"]) - float(manifest.get("compiling_s", 0.0))
    return PaperHint(shlex.join([*options, "--preset", PAPER]), _TIMES * max(run_s, 0.0))
