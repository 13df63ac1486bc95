"""The program `isd-gym` as ``python -m isd_gym``."""

from ._commands import main

main()
