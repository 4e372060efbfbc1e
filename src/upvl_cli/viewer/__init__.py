"""A drive in the viewer of Rerun: what its frames show, how it is logged, and where it goes."""
