"""Finished runs, from what is on disk to tables, figures and a report."""
