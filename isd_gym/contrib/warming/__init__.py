"""The command `isd-gym warm`: compilation of the kernel before its first use."""
