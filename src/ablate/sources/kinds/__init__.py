"""The kinds of sources: a module named as its `scene.kind`, with its class as `SOURCE`."""
