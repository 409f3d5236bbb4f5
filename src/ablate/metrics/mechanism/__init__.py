"""Metrics of mechanism: does each component of a generator do what it is for?"""
