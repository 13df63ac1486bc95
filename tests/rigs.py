"""Rigs that several tests measure."""

from isd_gym.physics.network import Network


def pushed_mass(name, outputs, **more):
    """Return a mass of 5 kg on a spring of 2000 N/m and a damper of 30 N s/m, pushed by a force.

    Args:
        name: Name of the model.
        outputs: Outputs of the model.
        more: Further entries of the model.
    """
    elements = [
        {"name": "spring", "type": "linear_stiffness", "between": ["mass", "ground"], "stiffness": 2000.0},
        {"name": "damper", "type": "linear_damping", "between": ["mass", "ground"], "damping": 30.0},
    ]
    push = {"name": "push", "quantity": "force", "at": "mass", "unit": "N"}
    model = {"schema": "isd-model/1", "name": name, "masses": {"mass": 5.0}, "elements": elements}
    return Network.load(model | {"inputs": [push], "outputs": outputs} | more)
