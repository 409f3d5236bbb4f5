"""Figures, from data frames to PNG and PDF."""
