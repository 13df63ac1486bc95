"""Policies from archives of Stable-Baselines3, and policies and controllers in other languages: plain C, ONNX."""
