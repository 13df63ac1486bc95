"""Policies and controllers in other languages: plain C, ONNX."""
