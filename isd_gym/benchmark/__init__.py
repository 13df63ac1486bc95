"""The benchmark: policies that drive an environment (`driving`, `policies`), their paired scores (`scoring`), cards of
references (`cards`), and their pictures (`show`).
"""
