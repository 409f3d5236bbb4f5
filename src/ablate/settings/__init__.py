"""Every key of conf/, declared once: as a field of a frozen dataclass with its type, default, range and unit."""
