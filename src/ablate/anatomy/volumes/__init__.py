"""Label volumes, such as segmentations of CT, made into closed surfaces."""
