"""A training, its scores, and a study as a list of jobs; from these to tables, figures, verdicts and a report."""
