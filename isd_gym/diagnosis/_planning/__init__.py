"""Design of the test that decides between the candidates of a diagnosis.

`excitation` has the test signals of a rig, `design` chooses among them.
"""
