"""Failed cells in words: lines for page and tables."""

from typing import Final

import pandas as pd

_MOST_NAMED: Final = 3  # Levels that a line names.


def failed_lines(rows: pd.DataFrame) -> list[str]:
    """Return a line for each consumer and reason in `failed.csv`, with the levels."""
    lines = []
    keys = ["consumer", "knowledge", "policy", "world", "why"]
    # A run of an earlier version names no policy or no world.
    texts = rows.assign(
        policy=rows["policy"].fillna("") if "policy" in rows else "",
        world=rows["world"].fillna("") if "world" in rows else "",
    )
    for (consumer, knows, policy, world, why), part in texts.groupby(keys, sort=False):
        name = f"{consumer} ({knows})" if str(knows) else consumer
        under = f" under {policy}" if str(policy) else ""
        under += f" in {world}" if str(world) else ""
        specs = list(part["spec"].unique())
        levels = ", ".join(specs[:_MOST_NAMED])
        if len(specs) > _MOST_NAMED:
            levels += f" and {len(specs) - _MOST_NAMED} more"
        lines.append(f"{name}{under} at {levels}: {why}; left out everywhere")
    return lines
