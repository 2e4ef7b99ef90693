"""Imports: logs of other programs as a study, with every point."""
