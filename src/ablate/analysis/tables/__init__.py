"""The comparison table and its formats."""
