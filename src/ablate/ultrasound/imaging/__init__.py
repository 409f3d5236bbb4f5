"""From echoes and scatterers to grey levels."""
