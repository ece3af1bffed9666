"""Screen, page, tables and figures of a finished run, and the words in them.

Data
    `finished` reads a run, `rows` and `lookups` select its numbers, `schemes` its
    swept mechanisms.
Tables
    A table is built once (`table`, `grid`) and rendered by `terminal`, `markup` or the
    page's templates; `tables` says which tables a reader gets. They are in `headline`,
    `result_tables`, `answer_tables`, `bounds`, `patrol_tables`, `return_tables`,
    `tracking_table` and `difference_tables`.
Screen
    `first_screen` has the first 24 lines, `announcements` the plan and the notices,
    `progress` the progress, `paper_hint` the next command, `listing` all names.
Pages
    `page` is that of a run, with the five questions (`answers`, `pictures`,
    `takeaways`) and the list of `error_sources`. `board_page` and `cards` are of a
    board, `study_page` of a study, `docs_pages` of the documentation.
Pictures
    `charts` draws for pages, one file each in `figures/`; `plots` for a notebook,
    `one_walk` for the README.
Words
    They stand beside the decision that they tell: `recommendation`, `notices`,
    `doubts`, `failed_cells`, `my_plugin`, `patrol_words`, `return_words`,
    `protection_record`; for `evaluation.design`: `design_words`, `noise_plan`,
    `patrol_advice`. All take plain names from `names`, numbers from `amounts` and
    meanings from `glossary`.
"""
