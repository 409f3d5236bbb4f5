"""What each `task=` does. A task imports the rooms that it needs when it starts."""
