"""Benchmarks: ratios taken in one run, alternating, medians; machines are noisy."""
