"""Rigged bodies and how to sample them: people for training, protocols and the demo."""

from .rigged import RiggedBody, load_body, save_body

__all__ = ["RiggedBody", "load_body", "save_body"]
