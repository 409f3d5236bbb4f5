"""Error against run time, of the simulator and of every trained run on disk: `task=precision`."""
