"""Run time against error, beside peers in the same run."""
