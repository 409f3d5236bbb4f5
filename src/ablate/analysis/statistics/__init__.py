"""Paired differences, claims, designs and their effects."""
