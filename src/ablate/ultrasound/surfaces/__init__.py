"""The surfaces of a scene: where rays meet them, and which structures a point is inside of."""
