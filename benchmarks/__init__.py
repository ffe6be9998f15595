"""Error beside time, ours beside the peers' in the same run: ``python -m benchmarks --output DIR``."""
