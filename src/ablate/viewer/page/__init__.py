"""The skin of the viewer: a page made with viser."""
