"""The benchmark: policies that drive an environment (`driving`, `policies`), their paired scores (`scoring`), cards of
references (`_cards`), and their pictures (`_show`).
"""
