"""Simulators of others as `scene.target` names them: examples of a simulator of your own (docs/own_simulator.md)."""
