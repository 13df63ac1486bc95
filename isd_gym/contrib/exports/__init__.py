"""Policies and controllers in other languages: plain C, ONNX."""

from .mpc_in_c import export_c as export_controller_in_c
from .onnx import export_onnx
from .policy_in_c import export_c as export_policy_in_c

__all__ = ["export_controller_in_c", "export_onnx", "export_policy_in_c"]
