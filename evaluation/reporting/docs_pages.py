"""Files of the documentation that are made of code and runs: glossary and pictures."""

import contextlib
from pathlib import Path
from typing import Final

from evaluation.reporting.glossary import glossary_page
from evaluation.reporting.one_walk import draw_walk, longest_walk
from evaluation.reporting.page import level_names
from evaluation.reporting.rows import Results
from evaluation.store.files import write_whole

GLOSSARY_PAGE: Final = Path("docs", "reference", "glossary.md")
FIGURES: Final = Path("docs", "figures")
PICTURE: Final = FIGURES / "one_walk.svg"
_SHOWN: Final = ("after_attack", "frontier", "linkability", "operating_points")
# Data set and preset of the figures in the docs.
_SOURCE: Final = ("students03", "paper")


def write_pages(run: Results, *, root: Path) -> list[Path]:
    """Write `docs/reference/glossary.md` and those pictures of the docs that the run has.

    The figures are from the preset `paper` on Students03, the walk from a simulated
    crowd. Walks of recorded people are not drawn: their licence may forbid it.

    Returns the paths of the written files. Raises DataError if a file cannot be
    written.
    """
    texts = {root / GLOSSARY_PAGE: glossary_page()}
    if run.manifest["dataset"]["simulated"] and run.gallery is not None:
        walk = longest_walk(run.gallery)
        if walk is not None:
            names = level_names(run.headline)
            name = names.get(walk.mechanism, walk.mechanism)
            texts[root / PICTURE] = draw_walk(walk, level_name=name)
    if (run.dataset, run.manifest["settings"]["preset"]) == _SOURCE:
        drawn = [run.out / "figures" / f"{name}.svg" for name in _SHOWN]
        known = [path for path in drawn if path.is_file()]
        texts |= {root / FIGURES / path.name: path.read_text("utf-8") for path in known}
    for path, text in texts.items():
        with contextlib.suppress(OSError):  # write_whole reports the fault
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    return list(texts)
