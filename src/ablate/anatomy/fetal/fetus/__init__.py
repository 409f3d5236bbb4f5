"""The fetus itself: trunk, head, organs, limbs and bones."""
