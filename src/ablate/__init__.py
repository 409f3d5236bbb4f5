"""Ablation studies of ultrasound-rendering GANs on pairs from a Monte-Carlo ray-tracing simulator."""
