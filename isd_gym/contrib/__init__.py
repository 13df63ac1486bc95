"""The command `isd-gym train`."""
