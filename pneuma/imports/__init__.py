"""Imports: logs of other programs as a study, of which every point is kept."""
