"""Who computes what is missing in a run folder: local processes, or a Dask cluster.

`execute` opens the folder, has its missing cells computed, and closes its manifest;
`plugin_calls` tries a user's plug-ins before. `pieces` cuts the missing cells into
works, `missing_cells` hands them out and writes each file as it comes. `workers` are
processes of this machine, with `serve` as their own side; `dask` is a cluster's.
`packing` turns cells into files, `failures` says what is tried again, `sample_tracks`
computes the tracks that are drawn. `memory` gives memory back between runs.
`rehearsal` and `duration` foresee what a run will take.
"""
