"""What makes the repository's own figures, its pages' tables and its site; it is not installed."""

COMMAND = "make figures"
"""The command that draws them, which each figure names as its origin."""
