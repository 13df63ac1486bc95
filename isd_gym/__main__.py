"""The program `isd-gym` as ``python -m isd_gym``."""

from .commands import main

main()
