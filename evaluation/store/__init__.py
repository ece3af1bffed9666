"""The run folder: its files, its manifest, and how they are written and checked.

`folder` opens, replaces and copies a run; `lock` keeps a second process out. `files`
names every file, and writes each whole or not at all. Numbers lie in `cell_files`
(parquet), with an index of what each file holds (`cell_index`), and `checksums` say
which files are as they were written. `manifest` describes the run (`describe`) and
lists its cells (`entries`); `merge_cells` joins those of this run and of earlier ones,
`new_files` decides which units share a file.

Readers: `linkage_outcomes`, `candidate_losses`, `sample_tracks`, `verdict_file`,
`csv_files`, `cards`. `people` holds the pseudonyms of the recorded ids, `public_text`
makes paths and words fit to be passed on.
"""
