"""Who computes what is missing in a run folder: local processes, or a Dask cluster."""
