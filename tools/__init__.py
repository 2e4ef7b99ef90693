"""What makes the repository's own figures, its pages' tables and its site; it is not installed."""
