"""From the command line to jobs that are composed, checked and started."""
