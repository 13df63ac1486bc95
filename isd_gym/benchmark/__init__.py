"""The benchmark: policies that drive an environment (`driving`, `policies`), their paired scores (`scoring`), cards of
references (`cards`), data sets (`record`), and sweeps over a grid of conditions (`grid`, `sweep`, `engine`).
"""
