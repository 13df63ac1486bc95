"""Simulated rigs whose truth is known, for the benchmarks and the tests; none of the integrators is the package's own.

- `families`: benches of many kinds and sizes with a hidden effect, and an integrator of their own;
- `hidden`: cars, device rigs and small networks with a hidden effect, made by `reference`;
- `reference`: an independent simulator of `isd-model/1` models, against which the package's kernel is validated;
- `random_networks`: networks drawn at random.
"""
