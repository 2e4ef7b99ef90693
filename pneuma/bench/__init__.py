"""Benchmarks: medians of ratios that are measured in alternation, as machines are noisy."""
