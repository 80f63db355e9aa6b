"""One graph over many recordings and parameter values: a Parquet table for each recorded output, on this machine or a cluster.

    jobs       what is to be done: a recording and the settings it is replayed with
    digests    what a job's results depend on, as one hash: graph, settings, recording, code, models
    manifest   what has been done: a file for every job, written after its tables
    parquet    an output's chunks as a Parquet file
    work       one job, in a worker
    cluster    the workers: processes of this machine, or those of a Dask cluster
    study      all of it in order: plan, leave out what is done, run, collect
    results    reading what came of it
    sessions   reading what came of one job as a recording is read

A worker knows nothing of the others, and what it has finished is on the disk: a killed batch goes on where it was.
"""
