"""Answers: what each question about a study gives, as one value for terminal, JSON, notebook and report."""
