"""Public path of `isd_gym.fmi.cosimulation`: a functional mock-up unit (FMU) as a model."""

from .fmi.cosimulation import WHY_TRUST, Port, Unit, UnitModel

__all__ = ["WHY_TRUST", "Port", "Unit", "UnitModel"]
