"""Straight lines through a scene: labels, attenuation and contact with the skin."""
