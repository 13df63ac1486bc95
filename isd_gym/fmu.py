"""Public path of `isd_gym.fmi.export`: a network as a functional mock-up unit. Exported units import this module."""

from .fmi.export import NetworkSlave, Running, export_fmu

__all__ = ["NetworkSlave", "Running", "export_fmu"]
