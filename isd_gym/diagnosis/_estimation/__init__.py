"""Estimation: structures and free parameters, initial states, sensitivities, Gauss-Newton fits, noise."""
