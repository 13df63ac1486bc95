"""Pages and pictures.

- `rendering`: frames and films of cars.
- `report`: pages of a score and of a diagnosis.
"""
