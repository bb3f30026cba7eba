"""A benchmark task that others can enter: its data, the runs of an entry, and what is written of them."""
