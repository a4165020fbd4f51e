"""Ratios of ufirext against named peers: `python -m benchmarks` prints the table, `--help` the options."""
