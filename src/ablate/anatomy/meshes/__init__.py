"""Real meshes made usable: cleaned, closed, checked."""
