"""A diagnosis of each of many cases: `isd-gym diagnose FOLDER`."""
