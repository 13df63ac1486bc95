"""What a suspension is and how it moves.

- `elements`, `network`: laws between nodes, and models made of them; `networks` has the built-in models.
- `_kernel`, `simulate`, `_balance`: compiled laws, simulation, and the position of rest.
- `road`, `tracks`, `_tyre_contact`: roads and what a tyre does on them.
- `vehicle`, `_batch`, `cost`: a network as a car, many cars side by side, and the stage cost.
"""
