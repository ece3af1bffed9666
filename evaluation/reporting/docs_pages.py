"""What the documentation takes from code and from a simulated run: glossary and picture."""

import contextlib
from pathlib import Path
from typing import Final

from evaluation.reporting.answers import headline_of
from evaluation.reporting.glossary import glossary_page
from evaluation.reporting.one_walk import longest_walk, one_walk
from evaluation.reporting.page import level_names
from evaluation.reporting.rows import Results
from evaluation.store.files import write_whole

GLOSSARY_PAGE: Final = Path("docs", "glossary.md")
FIGURES: Final = Path("docs", "figures")
PICTURE: Final = FIGURES / "one_walk.svg"
_SHOWN: Final = ("after_attack", "frontier", "linkability", "operating_points")
_SOURCE: Final = (
    "students03",
    "paper",
)  # Data set and preset of the figures in the docs.


def write_pages(run: Results, *, root: Path) -> list[Path]:
    """Write `docs/glossary.md`, and the pictures of the docs that are drawn from such a run.

    The figures are those of the preset `paper` on Students03, the walk is of a
    simulated crowd.

    Walks of recorded people are not drawn: their licence may forbid it. Return the
    paths of what was written. DataError if a file cannot be written.
    """
    texts = {root / GLOSSARY_PAGE: glossary_page()}
    if run.manifest["dataset"]["simulated"] and run.gallery is not None:
        walk = longest_walk(run.gallery)
        if walk is not None:
            names = level_names(headline_of(run))
            name = names.get(walk.mechanism, walk.mechanism)
            texts[root / PICTURE] = one_walk(walk, level_name=name)
    if (run.dataset, run.manifest["settings"]["preset"]) == _SOURCE:
        drawn = [run.out / "figures" / f"{name}.svg" for name in _SHOWN]
        known = [path for path in drawn if path.is_file()]
        texts |= {root / FIGURES / path.name: path.read_text("utf-8") for path in known}
    for path, text in texts.items():
        with contextlib.suppress(OSError):  # write_whole says what is wrong
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    return list(texts)
