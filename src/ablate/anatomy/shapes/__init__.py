"""Shapes that the built-in anatomy is made of."""
