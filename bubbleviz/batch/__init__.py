"""Many recordings to results and one table, in processes here or on a Dask cluster."""
